//! The rules that applications must follow with S140, and the RAM and time that S140 uses.

use std::collections::BTreeMap;

use super::super::nvic::Nvic;
use super::super::time::us;

/// Interrupts of S140: POWER_CLOCK, RADIO, TIMER0, RTC0, TEMP, RNG, ECB, CCM_AAR, SWI5.
pub const OWN_IRQS: u64 =
    1 << 0 | 1 << 1 | 1 << 8 | 1 << 11 | 1 << 12 | 1 << 13 | 1 << 14 | 1 << 15 | 1 << 25;
/// The interrupt that announces new events (SWI2_EGU2).
pub const EVENT_IRQ: usize = 22;
/// The priority of this interrupt.
pub const EVENT_PRIORITY: u8 = 6;
/// Priority of the calls.
pub const CALL_PRIORITY: u8 = 4;
/// Priorities that S140 uses itself.
const OWN_PRIORITIES: [u8; 3] = [0, 1, 4];
/// S140's peripherals by page: CLOCK and POWER, RADIO, TIMER0, RTC0, TEMP, RNG, ECB, CCM and AAR.
/// The next pages are EGU1, EGU2 and EGU5, NVMC with ACL, and MWU.
const OWN_PAGES: [u32; 13] = [0, 1, 8, 11, 12, 13, 14, 15, 21, 22, 25, 30, 32];
/// Names of the peripherals on these pages.
const PAGE_NAMES: [&str; 13] = [
    "POWER/CLOCK",
    "RADIO",
    "TIMER0",
    "RTC0",
    "TEMP",
    "RNG",
    "ECB",
    "CCM/AAR",
    "EGU1",
    "EGU2",
    "EGU5",
    "NVMC",
    "MWU",
];
/// Maximum time for which PRIMASK may delay S140's interrupts. Nordic does not specify it.
/// A radio packet has a turn-around time of 150 us, most of which S140 needs.
pub const LONGEST_PRIMASK: u64 = us(10);
/// Maximum stack use of S140 in the application's stack, from its specification.
pub const STACK_BYTES: u32 = 0x700;
/// Number of cycles of one call, including S140's own handler and its checks.
pub const CALL_CYCLES: u64 = us(5);
/// Number of cycles for forwarding an interrupt to the application's table.
pub const FORWARD_CYCLES: u64 = 40;

/// Time that S140 takes from the core in a connection event.
/// The values are the typical values in the SoftDevice specification.
/// They are in its section "BLE peripheral connection processor usage patterns".
/// The times are 40 us for preparation, 18 us at the start, 30 us after a packet and 90 us at the end.
/// At priority 4, each packet takes another 40 us.
pub const fn connection_event(packets: u64) -> u64 {
    us(40 + 18 + 90 + packets * (30 + 40))
}

/// Processor time of an advertising event on three channels: preparation, three packets, end.
pub const ADVERTISING_EVENT: u64 = us(40 + 3 * (18 + 30) + 90);

/// The configuration that `sd_ble_cfg_set` has set.
#[derive(Clone, Debug)]
pub struct Config {
    /// Tags of connection configurations.
    pub tag: Option<u8>,
    /// Number of connections.
    pub links: u32,
    /// Radio time of a connection event in units of 1.25 ms.
    pub event_length: u16,
    /// The largest ATT MTU.
    pub mtu: u16,
    /// Number of notifications that may be queued.
    pub notifications: usize,
    /// Number of vendor UUIDs.
    pub uuids: usize,
    /// Size of the attribute table in bytes.
    pub table: u32,
    /// Size of the device name.
    pub name: Vec<u8>,
    /// Number of roles as a peripheral.
    pub peripherals: u8,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            tag: None,
            links: 1,
            event_length: 3,
            mtu: 23,
            notifications: 1,
            uuids: 10,
            table: 1408,
            name: b"nRF5x".to_vec(),
            peripherals: 1,
        }
    }
}

impl Config {
    /// RAM that S140 needs from its start. Nordic documents no formula, so this estimate is above all known figures.
    /// These figures are 5.6 KB without a link, and 11 to 16 KB for one link with MTU 247.
    /// For five links with 9 notifications, the figure is 56 KB.
    pub fn ram_bytes(&self) -> u32 {
        let link = 1500 + (24 + self.notifications as u32) * (u32::from(self.mtu) + 20);
        5752 + self.table + 16 * self.uuids as u32 + self.links * link
    }
}

/// Violated rules, each with the number of violations.
#[derive(Clone, Debug, Default)]
pub struct Rules {
    broken: BTreeMap<String, u64>,
}

impl Rules {
    /// Records the violation of a rule.
    pub fn broke(&mut self, what: impl Into<String>) {
        *self.broken.entry(what.into()).or_default() += 1;
    }

    /// Returns a description of a violated rule.
    pub fn broken(&self) -> Option<&str> {
        self.broken.keys().next().map(String::as_str)
    }

    /// Checks an access of the core to a register while S140 is enabled.
    pub fn access(&mut self, address: u32, write: Option<u32>) {
        let how = if write.is_some() { "writes" } else { "reads" };
        let page = address >> 12 & 0xFF;
        match address {
            0x4000_0000..=0x4002_FFFF => {
                if let Some(i) = OWN_PAGES.iter().position(|&p| p == page) {
                    self.broke(format!("the image {how} {} at {address:#010x}", PAGE_NAMES[i]));
                }
                if page == 31
                    && let Some(value) = write
                {
                    self.ppi(address & 0xFFF, value);
                }
            }
            0xE000_E100..=0xE000_E2FF => {
                let high = address & 4 != 0;
                let own = if high { (OWN_IRQS >> 32) as u32 } else { OWN_IRQS as u32 };
                if write.is_some_and(|value| value & own != 0) {
                    self.broke(format!(
                        "the image writes an interrupt of S140 in the NVIC at {address:#010x}"
                    ));
                }
            }
            0xE000_E400..=0xE000_E42F if write.is_some() => {
                let irq = address - 0xE000_E400;
                if OWN_IRQS & (1 << irq) != 0 {
                    self.broke(format!("the image writes the priority of S140's interrupt {irq}"));
                }
            }
            0xE000_ED08 if write.is_some() => self.broke("the image moves the vector table"),
            _ => {}
        }
    }

    // Channels 17 to 31 and groups 4 and 5 belong to S140.
    fn ppi(&mut self, offset: u32, value: u32) {
        let own = match offset {
            0x000..=0x02C => offset / 8 >= 4,
            0x500 | 0x504 | 0x508 => value >> 17 != 0,
            0x510..=0x59C => (offset - 0x510) / 8 >= 17,
            0x800..=0x814 => (offset - 0x800) / 4 >= 4 || value >> 17 != 0,
            0x910..=0x98C => (offset - 0x910) / 4 >= 17,
            _ => false,
        };
        if own {
            self.broke(format!("the image writes a PPI channel or group of S140 at {offset:#x}"));
        }
    }

    /// Checks an interrupt whose handler in the application is about to run.
    pub fn interrupt(&mut self, irq: usize, nvic: &Nvic) {
        if OWN_IRQS & (1 << irq) != 0 {
            self.broke(format!("interrupt {irq} is S140's, the image has it enabled"));
        }
        let priority = nvic.irq_priority(irq);
        if OWN_PRIORITIES.contains(&priority) {
            self.broke(format!("interrupt {irq} has priority {priority}, which is S140's"));
        }
    }

    /// Checks the number of cycles for which interrupts were masked.
    pub fn masked(&mut self, cycles: u64) {
        if cycles > LONGEST_PRIMASK {
            self.broke(format!("PRIMASK held all interrupts for {} us", cycles / us(1)));
        }
    }
}

/// Returns whether `sd_softdevice_enable` would accept the current interrupt settings.
pub fn interrupts_fit(nvic: &Nvic) -> bool {
    (0..48).filter(|&irq| nvic.is_enabled(irq)).all(|irq| {
        OWN_IRQS & (1 << irq) == 0 && irq != EVENT_IRQ && !OWN_PRIORITIES.contains(&nvic.irq_priority(irq))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn breaks(what: impl FnOnce(&mut Rules)) -> bool {
        let mut rules = Rules::default();
        what(&mut rules);
        rules.broken().is_some()
    }

    #[test]
    fn peripherals_of_s140_are_out_of_reach_and_others_are_not() {
        for page in [0x4000_0000, 0x4000_1000, 0x4000_8000, 0x4000_B000, 0x4000_D000, 0x4001_E000] {
            assert!(breaks(|r| r.access(page + 0x504, None)), "{page:#x}");
            assert!(breaks(|r| r.access(page + 0x504, Some(1))), "{page:#x}");
        }
        // The interrupts of UARTE0, TWIM0, RTC1, TIMER1, WDT and USBD.
        for page in [0x4000_2000, 0x4000_3000, 0x4001_1000, 0x4000_9000, 0x4001_0000, 0x4002_7000] {
            assert!(!breaks(|r| r.access(page + 0x504, Some(1))), "{page:#x}");
        }
        assert!(!breaks(|r| r.access(0x4001_F504, Some(0b11))));
        assert!(breaks(|r| r.access(0x4001_F504, Some(1 << 17))));
        assert!(breaks(|r| r.access(0xE000_E180, Some(1))));
        assert!(!breaks(|r| r.access(0xE000_E180, Some(!(OWN_IRQS as u32)))));
    }

    #[test]
    fn an_enabled_interrupt_at_priority_0_1_or_4_is_refused() {
        for priority in 0..8u32 {
            let mut nvic = Nvic::default();
            nvic.write(0x400 + 2, priority << 5, 1);
            assert!(interrupts_fit(&nvic), "not enabled yet");
            nvic.write(0x100, 1 << 2, 4);
            assert_eq!(interrupts_fit(&nvic), ![0, 1, 4].contains(&priority), "priority {priority}");
        }
        let mut nvic = Nvic::default();
        nvic.write(0x400 + 1, 2 << 5, 1);
        nvic.write(0x100, 1 << 1, 4);
        assert!(!interrupts_fit(&nvic), "the radio's");
    }

    #[test]
    fn more_notifications_and_a_larger_mtu_need_more_ram() {
        let small = Config::default();
        let large = Config { mtu: 247, notifications: 8, ..Config::default() };
        assert!(large.ram_bytes() > small.ram_bytes() + 8 * 224);
    }

    #[test]
    fn masked_interrupts_are_counted_from_10_us_on() {
        assert!(!breaks(|r| r.masked(us(10))));
        assert!(breaks(|r| r.masked(us(11))));
    }
}
