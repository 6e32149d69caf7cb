//! Connects the core (unicorn's Cortex-M4F) with its chip: exceptions, sleep, resets, and the number of instructions.
//!
//! Unicorn executes the instructions, and this module does everything else.
//! While the core is awake, time advances with its instructions; while it sleeps, time jumps to the next event.

mod exceptions;
mod hooks;
mod measure;
mod radio;
mod update;

use unicorn_engine::{Arch, ArmCpuModel, HookType, Mode, Prot, RegisterARM, Unicorn};

pub use measure::{Call, Tapped};
use measure::{Open, PAINT, PAINTED};

use shared_board::update as layout;

use super::bmi270::Bmi270;
use super::i2c::Sensor;
use super::image::Image;
use super::lsm6ds3::Lsm6ds3;
use super::lsm9ds1::{Lsm9ds1, Motion};
use super::memory::{FLASH_BYTES, RAM_BYTES, RAM_START};
use super::nvic::FIRST_IRQ;
use super::soc::{SLOTS_END, SLOTS_START, Soc, Wiring};
use super::softdevice::rules::FORWARD_CYCLES;
use super::softdevice::{APPLICATION, Core, SoftDevice};
use super::time::{HZ, us};

/// Cycles per two instructions, because flash has wait states and loads take two cycles.
/// The value of 1.5 cycles per instruction is deliberately above the typical 1.2 to 1.4.
const CYCLES_PER_TWO: u64 = 3;
/// Marker that is stored in place of a number of instructions.
const ANSWERED: u16 = u16::MAX;
/// Number of cycles for entering or leaving an exception.
const EXCEPTION_CYCLES: u64 = 12;

/// The reason why the core stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stop {
    /// An event is due, or an interrupt is pending, before the block at this address.
    Attention { at: u32 },
    /// The core executed WFE or WFI at this address.
    Wait { at: u32, for_event: bool },
    /// A handler returned.
    ExceptionReturn,
    /// The core executed SVC; the program counter points to the next instruction.
    Supervisor,
    /// The core called the function at this address, and the emulator executes it instead of the core.
    Function(u32),
    /// A fault from which the core cannot continue.
    Fault(u32),
}

/// All data that hooks can access.
struct World {
    soc: Soc,
    stop: Option<Stop>,
    instructions: u64,
    thread_instructions: u64,
    half: u64,
    event: bool,
    /// Number of cycles spent on instructions, now and when interrupts were masked.
    executed: u64,
    masked_since: Option<u64>,
    /// Number of instructions of the block that starts at each half-word of flash.
    /// The value is 0 if the block has not run.
    /// The value is [`ANSWERED`] if the emulator executes the function itself.
    blocks: Vec<u16>,
    /// The function at this address, which the core itself executes this time.
    passes: Option<u32>,
    /// Addresses of instructions that the test counts, each with the index of its counter.
    /// There should be few addresses, because every block searches the whole list.
    probes: Vec<(u32, usize)>,
    calls: Vec<Vec<Call>>,
    /// Probes that fill the stack with a pattern.
    painting: Vec<usize>,
    open: Vec<Open>,
    taps: Vec<(u32, usize, usize)>,
    tapped: Vec<Vec<Tapped>>,
    bad_access: Option<String>,
}

impl World {
    /// Handles a change of PRIMASK, which S140 allows only for a short time.
    fn mask(&mut self, masks: bool) {
        if masks {
            self.masked_since.get_or_insert(self.executed);
        } else if let Some(since) = self.masked_since.take()
            && let Some(softdevice) = self.soc.softdevice.as_mut().filter(|s| s.is_enabled())
        {
            softdevice.rules.masked(self.executed - since);
        }
    }
}

/// The word and its address by which the stock bootloader detects a double press of reset.
const DOUBLE_PRESS: (u32, u32) = (0x2000_7FFC, 0x0773_8135);
/// RAM in which the stock bootloader has its stack.
const BOOTLOADER_STACK: std::ops::Range<u32> = 0x2000_6D48..0x2000_8D48;
/// Bits of RESETREAS that indicate resets by the pin, by the watchdog and by software.
const PIN: u32 = 1;
const WATCHDOG: u32 = 2;
const SOFT: u32 = 4;

/// The environment that starts the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Boot {
    /// A simulated stock bootloader, which leaves a vector table and some active peripherals.
    StockBootloader,
    /// The models of the MBR and the SoftDevice, which forward exceptions.
    SoftDevice,
}

/// The type of board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Nano 33 BLE Sense with an LSM9DS1.
    Nano33,
    /// Nano 33 BLE Sense Rev2 with a BMI270.
    Nano33Rev2,
    /// XIAO nRF52840 Sense with an LSM6DS3TR-C, S140 and a UF2 bootloader.
    Xiao,
}

impl Kind {
    fn sensor(self, motion: Box<dyn Motion>) -> Box<dyn Sensor> {
        match self {
            Self::Nano33 => Box::new(Lsm9ds1::new(motion)),
            Self::Nano33Rev2 => Box::new(Bmi270::new(motion)),
            Self::Xiao => Box::new(Lsm6ds3::new(motion)),
        }
    }

    /// The pins are those in the boards' documentation and, for the XIAO, in Zephyr's board files.
    fn wiring(self) -> Wiring {
        match self {
            Self::Nano33 | Self::Nano33Rev2 => Wiring {
                power: (0, 22),
                needs_high_drive: self == Self::Nano33Rev2,
                pull_ups: Some((1, 0)),
                sda: 14,
                scl: 15,
                uart_rx: (1, 10),
                led: [24, 16, 6],
            },
            Self::Xiao => Wiring {
                power: (1, 8),
                needs_high_drive: true,
                pull_ups: None,
                sda: 7,
                scl: 27,
                uart_rx: (1, 12),
                led: [26, 30, 6],
            },
        }
    }
}

/// The emulated board.
pub struct Board {
    uc: Unicorn<'static, World>,
    image: Image,
    boot: Boot,
    kind: Kind,
    slow_crystal: bool,
    asleep: bool,
    frames: Vec<bool>,
    /// Causes of all resets since power-up (RESETREAS).
    pub resets: Vec<u32>,
    /// Whether the simulated bootloader is active. It accepts an upload until the board is reset.
    /// Like the stock bootloader, this bootloader never feeds a watchdog.
    pub in_bootloader: bool,
    slept: u64,
}

impl Board {
    /// Returns a Nano 33 BLE Sense (Rev1) with the image in flash, before its start.
    ///
    /// # Panics
    /// Panics if the emulator cannot be set up.
    pub fn new(image: Image, boot: Boot, motion: Box<dyn Motion>) -> Self {
        Self::of_kind(Kind::Nano33, image, boot, motion)
    }

    /// Returns a board of this kind with the image in flash, before its start.
    ///
    /// # Panics
    /// Panics for the same reason as [`Self::new`].
    pub fn of_kind(kind: Kind, image: Image, boot: Boot, motion: Box<dyn Motion>) -> Self {
        let mut soc = Soc::new(kind.wiring(), kind.sensor(motion));
        for (address, bytes) in &image.pieces {
            soc.flash[*address as usize..][..bytes.len()].copy_from_slice(bytes);
        }
        if let Some(base) = image.second_stage {
            soc.images = base + layout::SLOT_B..base + layout::END;
        }
        if boot == Boot::SoftDevice {
            soc.softdevice = Some(Box::default());
        }
        let blocks = vec![0; soc.flash.len() / 2];
        let world = World {
            soc,
            stop: None,
            instructions: 0,
            thread_instructions: 0,
            half: 0,
            event: false,
            executed: 0,
            masked_since: None,
            blocks,
            passes: None,
            probes: Vec::new(),
            calls: Vec::new(),
            painting: Vec::new(),
            open: Vec::new(),
            taps: Vec::new(),
            tapped: Vec::new(),
            bad_access: None,
        };
        let mut uc =
            Unicorn::new_with_data(Arch::ARM, Mode::THUMB | Mode::MCLASS, world).expect("unicorn starts");
        uc.ctl_set_cpu_model(ArmCpuModel::CORTEX_M4 as i32).expect("a Cortex-M4F");
        // The firmware writes the two model slots itself, so they are registers from the core's point of view.
        // The firmware also writes the memory of a new image itself, and no program runs from there.
        let images = uc.get_data().soc.images.clone();
        let flash = uc.get_data().soc.flash.clone();
        let images_end = if images.is_empty() { 0 } else { images.end };
        for (start, end) in [(0, images.start), (images_end, SLOTS_START), (SLOTS_END, FLASH_BYTES as u32)] {
            if start < end {
                uc.mem_map(start.into(), u64::from(end - start), Prot::ALL).expect("flash");
                uc.mem_write(start.into(), &flash[start as usize..end as usize]).expect("flash");
            }
        }
        let ram = uc.get_data_mut().soc.ram.as_mut_ptr();
        // SAFETY: the RAM is in a box that lives as long as the emulator and never moves.
        unsafe { uc.mem_map_ptr(RAM_START.into(), RAM_BYTES as u64, Prot::ALL, ram.cast()) }.expect("RAM");
        for (start, len) in [
            (SLOTS_START, SLOTS_END - SLOTS_START),
            (images.start, images.end - images.start),
            (0x1000_0000, 0x2000),
            // This range includes the undocumented registers of the USB errata.
            (0x4000_0000, 0x10_0000),
            (0x5000_0000, 0x1000),
            (0xE000_1000, 0x1000),
            (0xE000_E000, 0x1000),
            (0xF000_0000, 0x1000),
        ] {
            if len == 0 {
                continue;
            }
            uc.mmio_map(
                start.into(),
                len.into(),
                Some(move |uc: &mut Unicorn<'_, World>, offset: u64, size: usize| {
                    u64::from(uc.get_data_mut().soc.read(start + offset as u32, size as u32))
                }),
                Some(move |uc: &mut Unicorn<'_, World>, offset: u64, size: usize, value: u64| {
                    let address = start + offset as u32;
                    Self::before_flash(uc, address, value as u32);
                    uc.get_data_mut().soc.write(address, value as u32, size as u32);
                    Self::after_flash(uc, address, value as u32);
                }),
            )
            .expect("registers");
        }
        Self::hook(&mut uc, &flash);
        let mut board = Self {
            uc,
            image,
            boot,
            kind,
            slow_crystal: false,
            asleep: false,
            frames: Vec::new(),
            resets: Vec::new(),
            in_bootloader: false,
            slept: 0,
        };
        board.start();
        board
    }

    fn reg(&self, register: RegisterARM) -> u32 {
        self.uc.reg_read(register).unwrap_or(0) as u32
    }

    fn set_reg(&mut self, register: RegisterARM, value: u32) {
        self.uc.reg_write(register, value.into()).expect("a register");
    }

    fn load(&self, address: u32) -> u32 {
        let mut bytes = [0; 4];
        let _ = self.uc.mem_read(address.into(), &mut bytes);
        u32::from_le_bytes(bytes)
    }

    /// Simulates the bootloader or the MBR before the image's first instruction.
    fn start(&mut self) {
        let table = self.image.vector_table;
        let (boot, kind, slow_crystal) = (self.boot, self.kind, self.slow_crystal);
        let soc = self.soc();
        if kind == Kind::Xiao && soc.power.read(0x51C) == 0x57 {
            soc.power.write(0x51C, 0, 0);
            self.in_bootloader = true;
            return;
        }
        if boot == Boot::StockBootloader {
            let stays = soc.power.read(0x51C) == 0xB0 || soc.ram.word(DOUBLE_PRESS.0) == DOUBLE_PRESS.1;
            soc.power.write(0x51C, 0, 0);
            soc.ram.put(BOOTLOADER_STACK.start, &vec![0xB0; BOOTLOADER_STACK.len()]);
            if stays {
                self.in_bootloader = true;
                return;
            }
            // The stock bootloader leaves its vector table active, and leaves the converter and the cache on.
            soc.write(0x4000_0578, 1, 4);
            soc.write(0x4001_E540, 1, 4);
            // UARTE0 still receives into one byte of the bootloader's RAM, which now belongs to the image.
            for (offset, value) in
                [(0x50C, 35), (0x514, 42), (0x524, 0x01D6_0000), (0x534, 0x2000_9BD4), (0x538, 1), (0x500, 8)]
            {
                soc.write(0x4000_2000 + offset, value, 4);
            }
            soc.write(0x4000_2000, 1, 4);
            // RTC1's compare interrupt is enabled.
            soc.write(0x4001_1304, 1 << 16, 4);
            if slow_crystal {
                soc.write(0x4000_0304, 1 << 1, 4);
            }
        }
        let (stack, entry) = (self.load(table), self.load(table + 4));
        for register in [RegisterARM::IPSR, RegisterARM::PRIMASK, RegisterARM::BASEPRI, RegisterARM::CONTROL]
        {
            self.set_reg(register, 0);
        }
        self.set_reg(RegisterARM::XPSR, 1 << 24);
        self.set_reg(RegisterARM::MSP, stack);
        self.set_reg(RegisterARM::SP, stack);
        self.set_reg(RegisterARM::LR, u32::MAX);
        self.set_reg(RegisterARM::PC, entry | 1);
        self.frames.clear();
        self.asleep = false;
        let world = self.uc.get_data_mut();
        world.event = false;
        world.masked_since = None;
        world.open.clear();
    }

    fn reset(&mut self, reason: u32) {
        self.resets.push(reason);
        assert!(self.resets.len() < 1000, "the image restarts for ever");
        self.soc().reset(reason);
        self.start();
    }

    /// The chip around the core.
    pub fn soc(&mut self) -> &mut Soc {
        &mut self.uc.get_data_mut().soc
    }

    /// Returns the virtual time in cycles.
    pub fn now(&self) -> u64 {
        self.uc.get_data().soc.now
    }

    /// Returns the cycle at which the firmware's clock (RTC1) was 0.
    pub fn clock_start(&self) -> u64 {
        super::time::cycle_of_tick(self.uc.get_data().soc.rtc1.zero_tick())
    }

    /// Returns whether the processor waits for an event.
    pub fn is_asleep(&self) -> bool {
        self.asleep
    }

    /// Returns the number of executed instructions.
    pub fn instructions(&self) -> u64 {
        self.uc.get_data().instructions
    }

    /// Returns the number of cycles awake since power-up.
    pub fn awake(&self) -> u64 {
        self.uc.get_data().soc.awake
    }

    /// Returns the linked image.
    pub fn image(&self) -> &Image {
        &self.image
    }

    /// Runs until this cycle of virtual time.
    ///
    /// # Panics
    /// Panics if the core faults. The message contains the address.
    pub fn run_until(&mut self, until: u64) {
        while self.now() < until {
            if self.in_bootloader {
                self.wait_in_bootloader(until);
                continue;
            }
            let soc = self.soc();
            if soc.nvmc.busy_until > soc.now {
                // The core and its interrupts are suspended while flash is written.
                let still = soc.nvmc.busy_until - soc.now;
                soc.now += still;
                soc.awake += still;
            }
            soc.advance();
            self.softdevice_woke();
            let soc = self.soc();
            let now = soc.now;
            if soc.watchdog.bites(now) {
                self.reset(WATCHDOG);
                continue;
            }
            if soc.nvic.reset_wanted {
                self.reset(SOFT);
                continue;
            }
            let (waiting, due) = (soc.nvic.any_ready(), soc.due);
            let basepri = self.reg(RegisterARM::BASEPRI) as u8;
            let masked = self.reg(RegisterARM::PRIMASK) & 1 != 0;
            if !masked
                && waiting
                && let Some(exception) = self.soc().nvic.next(basepri)
            {
                self.asleep = false;
                self.enter(exception);
            }
            if self.asleep {
                let event = std::mem::take(&mut self.uc.get_data_mut().event);
                if !event {
                    let to = due.min(until).max(now + 1);
                    self.slept += to - now;
                    self.soc().now = to;
                    continue;
                }
                self.asleep = false;
            }
            self.execute(until);
        }
        self.softdevice_woke();
    }

    /// Lets time pass in the simulated bootloader, until a watchdog that the image started resets the chip.
    fn wait_in_bootloader(&mut self, until: u64) {
        // The UF2 bootloader feeds an active watchdog.
        let feeds = self.kind == Kind::Xiao;
        let soc = self.soc();
        let bite = soc.watchdog.due().filter(|&due| due <= until && !feeds);
        soc.now = soc.now.max(bite.unwrap_or(until));
        if bite.is_some() {
            self.in_bootloader = false;
            self.reset(WATCHDOG);
        }
    }

    /// Presses the reset button.
    pub fn press_reset(&mut self) {
        self.in_bootloader = false;
        self.reset(PIN);
    }

    /// Simulates a slow crystal, whose start takes longer than the stock bootloader runs.
    /// The bootloader then leaves CLOCK's interrupt enabled.
    pub fn leave_clock_interrupt(&mut self) {
        self.slow_crystal = true;
        self.start();
    }

    /// Lets the program continue at the start of this function.
    pub fn jump(&mut self, function: &str) {
        let address = self.image.function(function);
        self.set_reg(RegisterARM::PC, address | 1);
        self.asleep = false;
    }

    /// Returns the S140 of the board.
    ///
    /// # Panics
    /// Panics if the image does not use S140.
    pub fn softdevice(&mut self) -> &mut SoftDevice {
        self.soc().softdevice.as_mut().expect("the image runs behind S140")
    }

    /// Runs for this many milliseconds of virtual time.
    pub fn run_ms(&mut self, milliseconds: u64) {
        let until = self.now() + us(milliseconds * 1000);
        self.run_until(until);
    }

    /// Returns the fraction of time awake so far, 0 to 1.
    pub fn awake_share(&self) -> f64 {
        self.awake() as f64 / self.now().max(1) as f64
    }

    /// Returns the virtual time in seconds.
    pub fn seconds(&self) -> f64 {
        self.now() as f64 / HZ as f64
    }

    /// Returns the bytes sent at D0 since the last call.
    pub fn uart_out(&mut self) -> Vec<u8> {
        self.soc().uart.take_sent().into_iter().map(|(_, byte)| byte).collect()
    }

    /// Sends bytes to the board at D1.
    pub fn uart_in(&mut self, bytes: &[u8]) {
        let soc = self.soc();
        soc.uart.receive(bytes, soc.now);
        soc.settle();
    }

    /// Returns the handler address of an interrupt in the linked table.
    pub fn vector(&self, irq: usize) -> u32 {
        self.load(self.image.vector_table + 4 * (FIRST_IRQ + irq) as u32)
    }
}
