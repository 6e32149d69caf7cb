//! The chip around the core: address map, interrupt lines, PPI, and the next event.

use super::controller::Controller;
use super::events::Events;
use super::flash::Nvmc;
use super::gpio::Port;
use super::i2c::{Bus, Sensor};
use super::memory::{FLASH_BYTES, Ram};
use super::nvic::Nvic;
use super::ppi::Ppi;
use super::pwm::Pwm;
use super::rtc::Rtc;
use super::saadc::Saadc;
use super::softdevice::SoftDevice;
use super::system::{ClockPower, Rng, Watchdog};
use super::timer::Timer;
use super::twim::Twim;
use super::uarte::Uarte;
use super::usbd::Usbd;

const CLOCK_POWER: usize = 0;
const UARTE0: usize = 2;
const TWIM0: usize = 3;
const GPIOTE: usize = 6;
const SAADC: usize = 7;
const TIMER0: usize = 8;
const RNG: usize = 13;
const RTC1: usize = 17;
const WDT: usize = 16;
const NVMC: usize = 30;
const PPI: usize = 31;
const PWM1: usize = 33;
const USBD: usize = 39;

/// Start address of the flash that the firmware writes itself: first bonds, then models.
pub const SLOTS_START: u32 = 0xD6000;
/// End address of this flash.
pub const SLOTS_END: u32 = 0xE0000;

/// A pin, given by its port (0 or 1) and its number.
type Pin = (usize, u32);

/// The connections of the board's pins.
#[derive(Clone, Copy, Debug)]
pub struct Wiring {
    /// The pin that supplies the sensor.
    pub power: Pin,
    /// Whether the sensor draws more current than a pin with standard drive can supply.
    pub needs_high_drive: bool,
    /// The pin that supplies the bus' pull-ups, if the sensor's pin does not supply them.
    pub pull_ups: Option<Pin>,
    /// SDA of the sensor's I2C bus, on port 0.
    pub sda: u32,
    /// SCL of the sensor's I2C bus, on port 0.
    pub scl: u32,
    /// The receiving pin, to which the laptop sends.
    pub uart_rx: Pin,
    /// The red, green and blue LED, on port 0.
    pub led: [u32; 3],
}

/// The complete chip except for the core.
pub struct Soc {
    /// Number of cycles since power-up.
    pub now: u64,
    /// The RAM of the chip.
    pub ram: Ram,
    /// Flash as the peripherals see it (the core's copy of the code is created only once).
    pub flash: Vec<u8>,
    /// The page UICR.
    pub uicr: Vec<u8>,
    /// The interrupt controller.
    pub nvic: Nvic,
    /// The clocks, power, and USB power.
    pub power: ClockPower,
    /// The UART at D0 and D1.
    pub uart: Uarte,
    /// The controller of the sensor bus.
    pub twim: Twim,
    gpiote: Events,
    /// The analog converter.
    pub saadc: Saadc,
    /// The PWM generator for the vibration motor.
    pub pwm1: Pwm,
    timers: [Timer; 5],
    /// The counter of the time driver.
    pub rtc1: Rtc,
    rng: Rng,
    /// The watchdog.
    pub watchdog: Watchdog,
    /// The flash controller.
    pub nvmc: Nvmc,
    /// Addresses of the new image and of the journal. The firmware itself writes to them.
    pub images: std::ops::Range<u32>,
    ppi: Ppi,
    /// The USB device controller.
    pub usb: Usbd,
    /// S140, if the image uses it.
    pub softdevice: Option<Box<SoftDevice>>,
    /// The model of Nordic's controller, if the image contains the controller.
    pub controller: Option<Box<Controller>>,
    /// The ports with all pins.
    pub ports: [Port; 2],
    /// The sensor bus with its devices.
    pub bus: Bus,
    /// The number of this chip among those of a test, which is part of its own address.
    pub number: u8,
    d1_is_open: bool,
    wiring: Wiring,
    /// Registers that only store their values, with their addresses.
    others: std::collections::HashMap<u32, u32>,
    /// The earliest cycle at which a peripheral has an event.
    pub due: u64,
    /// Number of cycles awake, which is also DWT's counter.
    pub awake: u64,
    dwt_offset: u64,
    /// The pages of peripherals that are not modelled but were accessed.
    pub unknown: std::collections::BTreeSet<u32>,
}

impl Soc {
    /// Returns a chip after power-up.
    pub fn new(wiring: Wiring, sensor: Box<dyn Sensor>) -> Self {
        Self {
            now: 0,
            ram: Ram::default(),
            flash: vec![0xFF; FLASH_BYTES],
            uicr: vec![0xFF; 4096],
            nvic: Nvic::default(),
            power: ClockPower::default(),
            uart: Uarte::default(),
            twim: Twim::default(),
            gpiote: Events::default(),
            saadc: Saadc::default(),
            pwm1: Pwm::default(),
            timers: Default::default(),
            rtc1: Rtc::default(),
            rng: Rng::new(1),
            watchdog: Watchdog::default(),
            nvmc: Nvmc::default(),
            images: 0..0,
            ppi: Ppi::default(),
            usb: Usbd::default(),
            softdevice: None,
            controller: None,
            ports: Default::default(),
            bus: Bus::new(sensor),
            d1_is_open: false,
            number: 0,
            wiring,
            others: Default::default(),
            due: u64::MAX,
            awake: 0,
            dwt_offset: 0,
            unknown: Default::default(),
        }
    }

    /// Resets the chip without a power-up. Memories, time and external connections are kept.
    /// `reason` is the reset's bit in RESETREAS.
    pub fn reset(&mut self, reason: u32) {
        const SOFT: u32 = 1 << 2;
        self.power.reset(reason);
        self.nvic = Nvic::default();
        let uart = std::mem::take(&mut self.uart);
        self.uart.keep_line(uart);
        self.twim = Twim::default();
        self.gpiote = Events::default();
        self.saadc.reset();
        self.pwm1.reset();
        self.timers = Default::default();
        self.rtc1 = Rtc::default();
        self.rng = Rng::new(self.now | 1);
        // A soft reset does not stop an active watchdog.
        if reason != SOFT {
            self.watchdog = Watchdog::default();
        }
        self.nvmc.reset();
        self.ppi = Ppi::default();
        self.usb.reset();
        if let Some(softdevice) = &mut self.softdevice {
            softdevice.reset(self.now);
        }
        if let Some(controller) = &mut self.controller {
            controller.reset(self.now);
        }
        self.ports = Default::default();
        self.others.clear();
        self.wires();
        self.settle();
    }

    /// Disconnects D0 and D1.
    pub fn unplug_uart(&mut self) {
        self.d1_is_open = true;
        self.wires();
        self.settle();
    }

    /// Exchanges levels between the pins and the devices connected to them.
    fn wires(&mut self) {
        let Wiring { power, needs_high_drive, pull_ups, sda, scl, uart_rx, .. } = self.wiring;
        let high = |(port, pin): Pin| self.ports[port].drives(pin) == Some(true);
        let supplied = high(power) && (!needs_high_drive || self.ports[power.0].drives_strongly(power.1));
        self.bus.supply(supplied, pull_ups.map_or(supplied, high), self.now);
        self.uart.set_floating(self.d1_is_open && !self.ports[uart_rx.0].pulls_up(uart_rx.1), self.now);
        if self.twim_is_off() {
            self.bus.drive_scl(self.ports[0].drives(scl) == Some(false));
        }
        let levels = self.bus.levels();
        self.ports[0].outside = u32::from(levels.0) << sda | u32::from(levels.1) << scl;
    }

    fn twim_is_off(&self) -> bool {
        self.twim.read(0x500) == 0
    }

    fn timer_index(page: usize) -> Option<usize> {
        match page {
            TIMER0..=10 => Some(page - TIMER0),
            26 | 27 => Some(page - 23),
            _ => None,
        }
    }

    fn read_word(&mut self, address: u32) -> u32 {
        let offset = address & 0xFFF;
        match address {
            0x4000_0000..=0x4002_FFFF => {
                let page = (address >> 12 & 0xFF) as usize;
                match page {
                    CLOCK_POWER => self.power.read(offset),
                    UARTE0 => self.uart.read(offset),
                    TWIM0 => self.twim.read(offset),
                    GPIOTE => self.gpiote.read(offset).unwrap_or(0),
                    SAADC => self.saadc.read(offset),
                    PWM1 => self.pwm1.read(offset),
                    RNG => self.rng.read(offset),
                    WDT => self.watchdog.read(offset),
                    RTC1 => self.rtc1.read(offset, self.now),
                    NVMC => self.nvmc.read(offset),
                    PPI => self.ppi.read(offset),
                    USBD => self.usb.read(offset),
                    _ => match Self::timer_index(page) {
                        Some(i) => self.timers[i].read(offset),
                        None => {
                            self.unknown.insert(address & !0xFFF);
                            self.others.get(&address).copied().unwrap_or(0)
                        }
                    },
                }
            }
            0x5000_0000..=0x5000_0FFF => {
                self.wires();
                self.ports[usize::from(Self::is_p1(offset))].read(Self::port_offset(offset))
            }
            0xE000_E000..=0xE000_EFFF => self.nvic.read(offset),
            0xE000_1004 => (self.awake - self.dwt_offset) as u32,
            0x1000_0000..=0x1000_0FFF => match offset {
                // These are INFO.PART and VARIANT ("AAF0": a chip with a self-locking debug port), and registers for errata checks.
                0x100 => 0x52840,
                0x104 => 0x4141_4630,
                0x130 => 0x8,
                0x134 => 0x3,
                // These are DEVICEID and DEVICEADDR.
                0x060 => 0x1234_5678,
                0x064 => 0x9ABC_DEF0,
                0x0A4 => 0x5566_7788 + u32::from(self.number),
                0x0A8 => 0x1122_C344,
                _ => u32::MAX,
            },
            0x1000_1000..=0x1000_1FFF => Self::word(&self.uicr, offset as usize),
            SLOTS_START..SLOTS_END => Self::word(&self.flash, address as usize),
            _ if self.images.contains(&address) => Self::word(&self.flash, address as usize),
            _ => self.others.get(&address).copied().unwrap_or(0),
        }
    }

    fn word(memory: &[u8], at: usize) -> u32 {
        memory.get(at..at + 4).map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
    }

    // Within the page, P0's registers start at 0x500, and P1's registers start at 0x800.
    fn is_p1(offset: u32) -> bool {
        matches!(offset, 0x804..=0x824 | 0xA00..=0xA7C)
    }

    fn port_offset(offset: u32) -> u32 {
        if Self::is_p1(offset) { offset - 0x300 } else { offset }
    }

    /// Processes a read by the core.
    pub fn read(&mut self, address: u32, size: u32) -> u32 {
        self.check(address, None);
        let word = self.read_word(address & !3);
        let shifted = word >> (8 * (address & 3));
        match size {
            1 => shifted & 0xFF,
            2 => shifted & 0xFFFF,
            _ => shifted,
        }
    }

    /// Lets S140 check an access of the core.
    fn check(&mut self, address: u32, write: Option<u32>) {
        if let Some(softdevice) = &mut self.softdevice
            && softdevice.is_enabled()
        {
            softdevice.rules.access(address, write);
        }
    }

    /// Processes a write by the core.
    pub fn write(&mut self, address: u32, value: u32, size: u32) {
        self.check(address, Some(value));
        self.write_quietly(address, value, size);
        self.run_ppi();
        self.settle();
    }

    fn write_quietly(&mut self, address: u32, value: u32, size: u32) {
        let offset = address & 0xFFF;
        let now = self.now;
        match address {
            0x4000_0000..=0x4002_FFFF => {
                let page = (address >> 12 & 0xFF) as usize;
                match page {
                    CLOCK_POWER => self.power.write(offset, value, now),
                    UARTE0 => self.uart.write(offset, value, now, &self.ram),
                    TWIM0 => {
                        self.twim.write(offset, value, now);
                        // If the controller uses other pins, no device answers.
                        self.bus.wired = (self.twim.read(0x508), self.twim.read(0x50C))
                            == (self.wiring.scl, self.wiring.sda);
                    }
                    GPIOTE => {
                        self.gpiote.write(offset, value);
                    }
                    SAADC => self.saadc.write(offset, value, now),
                    PWM1 => self.pwm1.write(offset, value, now, &self.ram),
                    RNG => self.rng.write(offset, value, now),
                    WDT => self.watchdog.write(offset, value, now),
                    RTC1 => self.rtc1.write(offset, value, now),
                    NVMC => {
                        if offset == 0x508 && self.nvmc.may_erase() {
                            self.nvmc.erase(&mut self.flash, value as usize, now);
                        }
                        if offset == 0x518 && self.nvmc.may_erase() {
                            self.nvmc.erase_partly(&mut self.flash, value as usize, now);
                        }
                        self.nvmc.write(offset, value);
                    }
                    PPI => self.ppi.write(offset, value),
                    USBD => self.usb.write(offset, value, now, &mut self.ram),
                    _ => match Self::timer_index(page) {
                        Some(i) => self.timers[i].write(offset, value, now),
                        None => {
                            self.unknown.insert(address & !0xFFF);
                            self.others.insert(address, value);
                        }
                    },
                }
            }
            0x5000_0000..=0x5000_0FFF => {
                self.ports[usize::from(Self::is_p1(offset))].write(Self::port_offset(offset), value);
                self.wires();
            }
            0xE000_E000..=0xE000_EFFF => self.nvic.write(offset, value, size),
            0xE000_1004 => self.dwt_offset = self.awake - u64::from(value),
            0x1000_1000..=0x1000_1FFF if self.nvmc.may_write() => {
                self.nvmc.program(&mut self.uicr, offset as usize, value, now);
            }
            SLOTS_START..SLOTS_END if self.nvmc.may_write() => {
                self.nvmc.program(&mut self.flash, address as usize, value, now);
            }
            _ if self.images.contains(&address) && self.nvmc.may_write() => {
                self.nvmc.program(&mut self.flash, address as usize, value, now);
            }
            _ => {
                self.others.insert(address, value);
            }
        }
    }

    fn for_each_events(&mut self, mut f: impl FnMut(u32, &mut Events)) {
        f(CLOCK_POWER as u32, &mut self.power.events);
        f(UARTE0 as u32, &mut self.uart.events);
        f(TWIM0 as u32, &mut self.twim.events);
        f(GPIOTE as u32, &mut self.gpiote);
        f(SAADC as u32, &mut self.saadc.events);
        f(PWM1 as u32, &mut self.pwm1.events);
        for (i, timer) in self.timers.iter_mut().enumerate() {
            f(if i < 3 { TIMER0 + i } else { i + 23 } as u32, &mut timer.events);
        }
        f(RNG as u32, &mut self.rng.events);
        f(WDT as u32, &mut self.watchdog.events);
        f(RTC1 as u32, &mut self.rtc1.events);
        f(USBD as u32, &mut self.usb.events);
    }

    /// Passes new events to the PPI until there are no more.
    fn run_ppi(&mut self) {
        loop {
            let mut fired = Vec::new();
            self.for_each_events(|page, events| {
                if events.has_fired() {
                    let register = |event| 0x4000_0000 + (page << 12) + 0x100 + 4 * event;
                    fired.extend(events.take_fired().into_iter().map(register));
                }
            });
            if fired.is_empty() {
                return;
            }
            for event in fired {
                for task in self.ppi.tasks_of(event) {
                    self.write_quietly(task, 1, 4);
                }
            }
        }
    }

    /// Updates interrupt lines and the next due cycle.
    pub fn settle(&mut self) {
        let mut lines = 0;
        self.for_each_events(|page, events| lines |= u64::from(events.irq()) << page);
        self.nvic.set_lines(lines);
        let softdevice = self.softdevice.as_ref().and_then(|s| s.due(&self.power, self.now));
        let controller = self.controller.as_ref().and_then(|c| c.due(self));
        self.due = [
            softdevice,
            controller,
            self.power.due(),
            self.uart.due(),
            self.twim.due(),
            self.saadc.due(),
            self.pwm1.due(),
            self.rtc1.due(),
            self.rng.due(),
            self.watchdog.due(),
            self.usb.due(),
        ]
        .into_iter()
        .flatten()
        .min()
        .unwrap_or(u64::MAX);
    }

    /// Performs all actions that are due, in order.
    pub fn advance(&mut self) {
        let now = self.now;
        while self.due <= now && !self.watchdog.bites(self.due) {
            let at = self.due;
            self.power.advance(at);
            self.uart.advance(at, &mut self.ram);
            self.twim.advance(at, &mut self.ram, &mut self.bus);
            self.saadc.advance(at, &mut self.ram);
            self.pwm1.advance(at);
            self.rtc1.advance(at);
            self.rng.advance(at);
            self.usb.advance(at, &mut self.ram);
            if let Some(mut softdevice) = self.softdevice.take() {
                softdevice.advance(at, self);
                self.softdevice = Some(softdevice);
            }
            if let Some(mut controller) = self.controller.take() {
                controller.advance(at, self);
                self.controller = Some(controller);
            }
            self.run_ppi();
            self.settle();
        }
    }

    /// Returns whether the red, green and blue LED are lit.
    pub fn led(&self) -> [bool; 3] {
        self.wiring.led.map(|pin| self.ports[0].drives(pin) == Some(false))
    }
}
