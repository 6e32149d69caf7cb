//! PPI: connects events of one peripheral to tasks of another, without the core.

/// The image does not use channels with fixed wiring, so they are not modelled.
const CHANNELS: usize = 20;

/// The programmable channels and their groups.
#[derive(Clone, Debug, Default)]
pub struct Ppi {
    enabled: u32,
    event: [u32; CHANNELS],
    task: [u32; CHANNELS],
    fork: [u32; 32],
    groups: [u32; 6],
}

impl Ppi {
    /// Returns the addresses of the tasks that an event triggers.
    pub fn tasks_of(&self, event: u32) -> Vec<u32> {
        let mut tasks = Vec::new();
        if self.enabled != 0 {
            for channel in 0..CHANNELS {
                if self.enabled & (1 << channel) != 0 && self.event[channel] == event {
                    tasks.extend([self.task[channel], self.fork[channel]].into_iter().filter(|&t| t != 0));
                }
            }
        }
        tasks
    }

    /// Reads a register.
    pub fn read(&self, offset: u32) -> u32 {
        match offset {
            0x500 | 0x504 | 0x508 => self.enabled,
            0x510..=0x5AC => {
                let index = (offset as usize - 0x510) / 8;
                if offset.is_multiple_of(8) { self.event[index] } else { self.task[index] }
            }
            0x800..=0x814 => self.groups[(offset as usize - 0x800) / 4],
            0x910..=0x98C => self.fork[(offset as usize - 0x910) / 4],
            _ => 0,
        }
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32) {
        match offset {
            // The tasks of channel groups enable or disable groups 0 to 5.
            0x000..=0x02C if value & 1 != 0 => {
                let channels = self.groups[offset as usize / 8];
                if offset.is_multiple_of(8) { self.enabled |= channels } else { self.enabled &= !channels }
            }
            0x500 => self.enabled = value,
            0x504 => self.enabled |= value,
            0x508 => self.enabled &= !value,
            0x510..=0x5AC => {
                let index = (offset as usize - 0x510) / 8;
                if offset.is_multiple_of(8) { self.event[index] = value } else { self.task[index] = value }
            }
            0x800..=0x814 => self.groups[(offset as usize - 0x800) / 4] = value,
            0x910..=0x98C => self.fork[(offset as usize - 0x910) / 4] = value,
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_event_triggers_task_and_fork_of_its_enabled_channels() {
        let mut ppi = Ppi::default();
        ppi.write(0x518, 0x4000_2108);
        ppi.write(0x51C, 0x4000_9008);
        ppi.write(0x914, 0x4001_F004);
        assert!(ppi.tasks_of(0x4000_2108).is_empty());
        ppi.write(0x504, 1 << 1);
        assert_eq!(ppi.tasks_of(0x4000_2108), [0x4000_9008, 0x4001_F004]);
        ppi.write(0x800, 1 << 1);
        ppi.write(0x004, 1);
        assert!(ppi.tasks_of(0x4000_2108).is_empty());
        ppi.write(0x000, 1);
        assert_eq!(ppi.read(0x500), 2);
    }
}
