//! NVIC and the parts of the System Control Block that the image uses: pending and enabled interrupts, and priorities.

/// Number of the chip's external interrupts.
const IRQS: usize = 48;
/// Number of exceptions before the external interrupts.
pub const FIRST_IRQ: usize = 16;
/// Numbers of the modelled exceptions whose priority can be set.
pub const SVCALL: usize = 11;
/// Exception number of PendSV.
pub const PENDSV: usize = 14;
/// Exception number of SysTick.
pub const SYSTICK: usize = 15;
/// Priority of code outside exceptions.
pub const THREAD: i32 = 256;

/// The interrupt controller.
#[derive(Clone, Debug)]
pub struct Nvic {
    enabled: u64,
    pending: u64,
    lines: u64,
    active: Vec<usize>,
    priority: [u8; IRQS],
    system_priority: [u8; 16],
    pendsv: bool,
    /// VTOR: address of the vector table.
    pub vector_table: u32,
    registers: [u32; 8],
    /// Whether a reset was requested through AIRCR.
    pub reset_wanted: bool,
}

impl Default for Nvic {
    fn default() -> Self {
        Self {
            enabled: 0,
            pending: 0,
            lines: 0,
            active: Vec::new(),
            priority: [0; IRQS],
            system_priority: [0; 16],
            pendsv: false,
            vector_table: 0,
            registers: [0; 8],
            reset_wanted: false,
        }
    }
}

impl Nvic {
    /// Sets the levels of all interrupt lines.
    pub fn set_lines(&mut self, lines: u64) {
        // A high line makes an interrupt pending unless its handler is running.
        let mut pends = lines;
        for &exception in &self.active {
            if exception >= FIRST_IRQ {
                pends &= !(1 << (exception - FIRST_IRQ));
            }
        }
        self.lines = lines;
        self.pending |= pends;
    }

    /// Pends one interrupt.
    pub fn pend(&mut self, irq: usize) {
        self.pending |= 1 << irq;
    }

    /// Returns whether an interrupt is enabled.
    pub fn is_enabled(&self, irq: usize) -> bool {
        self.enabled & (1 << irq) != 0
    }

    /// Returns the priority register of an interrupt, 0 to 7.
    pub fn irq_priority(&self, irq: usize) -> u8 {
        self.priority[irq] >> 5
    }

    /// Returns the priority of an exception; lower is more urgent.
    pub fn priority_of(&self, exception: usize) -> i32 {
        match exception {
            2 => -2,
            3 => -1,
            4..=15 => i32::from(self.system_priority[exception]),
            _ => i32::from(self.priority[exception - FIRST_IRQ]),
        }
    }

    /// Returns the priority of the running code.
    pub fn running(&self) -> i32 {
        self.active.iter().map(|&e| self.priority_of(e)).min().unwrap_or(THREAD)
    }

    /// Returns the most urgent exception whose priority is high enough to interrupt the running code.
    pub fn next(&self, basepri: u8) -> Option<usize> {
        let limit = if basepri == 0 { self.running() } else { self.running().min(i32::from(basepri)) };
        let ready = self.pending & self.enabled;
        let irqs = (0..IRQS).filter(|&i| ready & (1 << i) != 0).map(|i| i + FIRST_IRQ);
        let system = self.pendsv.then_some(PENDSV);
        system
            .into_iter()
            .chain(irqs)
            .min_by_key(|&e| (self.priority_of(e), e))
            .filter(|&e| self.priority_of(e) < limit)
    }

    /// Returns whether an enabled interrupt of any priority is pending, which wakes a sleeping core.
    pub fn any_ready(&self) -> bool {
        self.pendsv || self.pending & self.enabled != 0
    }

    /// Starts the handler of an exception.
    pub fn enter(&mut self, exception: usize) {
        if exception == PENDSV {
            self.pendsv = false;
        } else if exception >= FIRST_IRQ {
            self.pending &= !(1 << (exception - FIRST_IRQ));
        }
        self.active.push(exception);
    }

    /// Ends the newest handler and returns its exception number.
    pub fn leave(&mut self) -> Option<usize> {
        let exception = self.active.pop();
        self.set_lines(self.lines);
        exception
    }

    /// Returns the exceptions whose handlers are running, the newest last.
    pub fn active(&self) -> &[usize] {
        &self.active
    }

    /// Reads a register of the System Control Space (offset from 0xE000_E000).
    pub fn read(&self, offset: u32) -> u32 {
        let half = |word: u64, at: u32| if at == 0 { word as u32 } else { (word >> 32) as u32 };
        match offset {
            0x100 | 0x104 => half(self.enabled, offset - 0x100),
            0x180 | 0x184 => half(self.enabled, offset - 0x180),
            0x200 | 0x204 => half(self.pending, offset - 0x200),
            0x280 | 0x284 => half(self.pending, offset - 0x280),
            0x300 | 0x304 => {
                let active = self
                    .active
                    .iter()
                    .filter(|&&e| e >= FIRST_IRQ)
                    .fold(0u64, |a, &e| a | 1 << (e - FIRST_IRQ));
                half(active, offset - 0x300)
            }
            0x400..=0x42F => {
                let at = offset as usize - 0x400;
                u32::from_le_bytes([
                    self.priority[at],
                    self.priority[at + 1],
                    self.priority[at + 2],
                    self.priority[at + 3],
                ])
            }
            // This is the CPUID of a Cortex-M4 r0p1.
            0xD00 => 0x410F_C241,
            0xD04 => {
                let pending = self.next(0).unwrap_or(0) as u32;
                self.active.last().map_or(0, |&e| e as u32) | pending << 12 | u32::from(self.pendsv) << 28
            }
            0xD08 => self.vector_table,
            0xD0C => 0xFA05_0000,
            0xD10 => self.registers[0],
            0xD14 => self.registers[1],
            0xD18..=0xD20 => {
                let at = offset as usize - 0xD18 + 4;
                u32::from_le_bytes(std::array::from_fn(|i| self.system_priority[at + i]))
            }
            0xD24 => self.registers[2],
            0xD88 => self.registers[3],
            0xDFC => self.registers[4],
            _ => 0,
        }
    }

    /// Writes a byte or a word to a register of the System Control Space.
    pub fn write(&mut self, offset: u32, value: u32, size: u32) {
        let place = |at: u32| if at == 0 { u64::from(value) } else { u64::from(value) << 32 };
        match offset {
            0x100 | 0x104 => self.enabled |= place(offset - 0x100),
            0x180 | 0x184 => self.enabled &= !place(offset - 0x180),
            0x200 | 0x204 => self.pending |= place(offset - 0x200),
            0x280 | 0x284 => {
                self.pending &= !place(offset - 0x280);
                self.set_lines(self.lines);
            }
            0x400..=0x42F => {
                for i in 0..size {
                    // Only three bits of a priority are implemented.
                    self.priority[(offset - 0x400 + i) as usize] = (value >> (8 * i)) as u8 & 0xE0;
                }
            }
            0xD04 => {
                if value & (1 << 28) != 0 {
                    self.pendsv = true;
                }
                if value & (1 << 27) != 0 {
                    self.pendsv = false;
                }
            }
            0xD08 => self.vector_table = value & !0x7F,
            0xD0C => self.reset_wanted |= value >> 16 == 0x05FA && value & 4 != 0,
            0xD10 => self.registers[0] = value,
            0xD14 => self.registers[1] = value,
            0xD18..=0xD23 => {
                for i in 0..size {
                    self.system_priority[(offset - 0xD18 + 4 + i) as usize] = (value >> (8 * i)) as u8 & 0xE0;
                }
            }
            0xD24 => self.registers[2] = value,
            0xD88 => self.registers[3] = value,
            0xDFC => self.registers[4] = value,
            0xF00 => self.pend((value & 0x1FF) as usize),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(irqs: &[(u32, u8)]) -> Nvic {
        let mut nvic = Nvic::default();
        for &(irq, priority) in irqs {
            nvic.write(0x400 + irq, u32::from(priority) << 5, 1);
            nvic.write(0x100 + 4 * (irq / 32), 1 << (irq % 32), 4);
        }
        nvic
    }

    #[test]
    fn the_more_urgent_interrupt_comes_first_and_preempts_and_the_others_wait() {
        let mut nvic = with(&[(3, 3), (17, 2), (39, 3)]);
        nvic.pend(39);
        nvic.pend(3);
        assert_eq!(nvic.next(0), Some(19));
        nvic.enter(19);
        assert_eq!(nvic.next(0), None);
        nvic.pend(17);
        assert_eq!(nvic.next(0), Some(33));
        nvic.enter(33);
        assert_eq!(nvic.leave(), Some(33));
        assert_eq!(nvic.next(0), None);
        assert_eq!(nvic.leave(), Some(19));
        assert_eq!(nvic.next(0), Some(55));
    }

    #[test]
    fn a_line_that_stays_high_pends_again_after_its_handler() {
        let mut nvic = with(&[(3, 3)]);
        nvic.set_lines(1 << 3);
        nvic.enter(nvic.next(0).unwrap());
        nvic.set_lines(1 << 3);
        assert_eq!(nvic.next(0), None);
        nvic.leave();
        assert_eq!(nvic.next(0), Some(19));
    }

    #[test]
    fn base_priority_masks_what_is_not_more_urgent() {
        let mut nvic = with(&[(3, 3)]);
        nvic.pend(3);
        assert_eq!(nvic.next(3 << 5), None);
        assert_eq!(nvic.next(4 << 5), Some(19));
    }

    #[test]
    fn an_interrupt_that_is_not_enabled_waits_and_does_not_wake() {
        let mut nvic = Nvic::default();
        nvic.pend(5);
        assert!(!nvic.any_ready() && nvic.next(0).is_none());
        nvic.write(0x100, 1 << 5, 4);
        assert!(nvic.any_ready());
    }

    #[test]
    fn a_reset_needs_the_key() {
        let mut nvic = Nvic::default();
        nvic.write(0xD0C, 4, 4);
        assert!(!nvic.reset_wanted);
        nvic.write(0xD0C, 0x05FA_0004, 4);
        assert!(nvic.reset_wanted);
    }
}
