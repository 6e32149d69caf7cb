//! The core (unicorn's Cortex-M4F) in its chip: exceptions, sleep, resets, and counting instructions.
//!
//! Unicorn executes instructions; everything else is here. Time goes by instructions while the core is
//! awake and jumps to the next due event while it sleeps.

use unicorn_engine::{Arch, ArmCpuModel, HookType, Mode, Prot, RegisterARM, Unicorn};

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

/// Cycles per two instructions: the flash has wait states and loads take two cycles; 1.5 per
/// instruction is on the safe side of the 1.2 to 1.4 of `../shared/reference/peers.md`.
const CYCLES_PER_TWO: u64 = 3;
/// Entering or leaving an exception.
const EXCEPTION_CYCLES: u64 = 12;

/// Why the core stopped executing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stop {
    /// Something is due or an interrupt is ready, before the block at this address.
    Attention { at: u32 },
    /// WFE or WFI was reached, at this address.
    Wait { at: u32, for_event: bool },
    /// A handler returned.
    ExceptionReturn,
    /// SVC; the program counter is behind it.
    Supervisor,
    /// What the core cannot go on from.
    Fault(u32),
}

/// One measured call of a function.
#[derive(Clone, Copy, Debug)]
pub struct Call {
    /// Cycle at which it began.
    pub at: u64,
    /// Executed instructions, those of interrupts in between left out.
    pub instructions: u64,
    /// Bytes below the stack pointer of the call that were written to; 0 unless [asked for](Board::probe_stack).
    pub stack_bytes: u32,
}

/// A measured call under way.
#[derive(Clone, Copy, Debug)]
struct Open {
    back: u32,
    probe: usize,
    at: u64,
    instructions_before: u64,
    stack_pointer: u32,
}

/// Bytes below the stack pointer that are painted to see how deep a call goes.
const PAINTED: usize = 2048;
const PAINT: u8 = 0x6B;

/// What a tap saw at one call.
#[derive(Clone, Debug)]
pub struct Tapped {
    /// Cycle of the call.
    pub at: u64,
    /// Registers r0 to r3.
    pub registers: [u32; 4],
    /// Bytes behind r0.
    pub bytes: Vec<u8>,
}

/// Everything that hooks reach.
struct World {
    soc: Soc,
    stop: Option<Stop>,
    instructions: u64,
    thread_instructions: u64,
    half: u64,
    event: bool,
    /// Cycles of executed instructions, and how many they were when interrupts were masked.
    executed: u64,
    masked_since: Option<u64>,
    /// Instructions of the block that starts at each half-word of flash; 0 where none was executed yet.
    blocks: Vec<u16>,
    /// Addresses and numbers; few, and looked through at every block.
    probes: Vec<(u32, usize)>,
    calls: Vec<Vec<Call>>,
    /// Probes that paint the stack.
    painting: Vec<usize>,
    open: Vec<Open>,
    taps: Vec<(u32, usize, usize)>,
    tapped: Vec<Vec<Tapped>>,
    bad_access: Option<String>,
}

impl World {
    /// PRIMASK changes; S140 does not like it long.
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

/// What the stock bootloader takes for a double press of reset: this word at this address.
const DOUBLE_PRESS: (u32, u32) = (0x2000_7FFC, 0x0773_8135);
/// RAM that the stock bootloader uses as its stack.
const BOOTLOADER_STACK: std::ops::Range<u32> = 0x2000_6D48..0x2000_8D48;
/// A reset by the pin, by the watchdog and by software, in RESETREAS.
const PIN: u32 = 1;
const WATCHDOG: u32 = 2;
const SOFT: u32 = 4;

/// How the image is started.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Boot {
    /// By a stand-in for the stock bootloader, which leaves its table and some peripherals behind.
    StockBootloader,
    /// By the MBR and the SoftDevice, which forwards exceptions.
    SoftDevice,
}

/// Which board it is.
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

    /// As in `../shared/reference/hardware.md` and, for the XIAO, Zephyr's board files.
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
    /// Resets since power-up, with their reasons (RESETREAS).
    pub resets: Vec<u32>,
    /// The stand-in bootloader was asked to stay. It takes an upload until the board is reset; like the stock one it
    /// never feeds a watchdog.
    pub in_bootloader: bool,
    slept: u64,
}

fn decode(soc_flash: &[u8], address: u32, size: u32) -> u64 {
    let mut count = 0;
    let mut at = address as usize;
    let end = at + size as usize;
    while at < end {
        let half = soc_flash.get(at..at + 2).map_or(0, |b| u16::from_le_bytes([b[0], b[1]]));
        at += if half >> 11 >= 0b11101 { 4 } else { 2 };
        count += 1;
    }
    count
}

impl Board {
    /// A Nano 33 BLE Sense (Rev1) with the image in its flash, about to start.
    ///
    /// # Panics
    /// Where the emulator cannot be set up.
    pub fn new(image: Image, boot: Boot, motion: Box<dyn Motion>) -> Self {
        Self::of_kind(Kind::Nano33, image, boot, motion)
    }

    /// A board of this kind with the image in its flash, about to start.
    ///
    /// # Panics
    /// As [`Self::new`].
    pub fn of_kind(kind: Kind, image: Image, boot: Boot, motion: Box<dyn Motion>) -> Self {
        let mut soc = Soc::new(kind.wiring(), kind.sensor(motion));
        for (address, bytes) in &image.pieces {
            soc.flash[*address as usize..][..bytes.len()].copy_from_slice(bytes);
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
        // The two model slots are written by the firmware itself, so they are registers to the core.
        uc.mem_map(0, u64::from(SLOTS_START), Prot::ALL).expect("flash");
        let behind = u64::from(SLOTS_END);
        uc.mem_map(behind, FLASH_BYTES as u64 - behind, Prot::ALL).expect("flash");
        let flash = uc.get_data().soc.flash.clone();
        uc.mem_write(0, &flash[..SLOTS_START as usize]).expect("flash");
        uc.mem_write(behind, &flash[SLOTS_END as usize..]).expect("flash");
        let ram = uc.get_data_mut().soc.ram.as_mut_ptr();
        // SAFETY: the RAM lies in a box that lives as long as the emulator and never moves.
        unsafe { uc.mem_map_ptr(RAM_START.into(), RAM_BYTES as u64, Prot::ALL, ram.cast()) }.expect("RAM");
        for (start, len) in [
            (SLOTS_START, SLOTS_END - SLOTS_START),
            (0x1000_0000, 0x2000),
            // With the hidden registers that errata of USB are about.
            (0x4000_0000, 0x10_0000),
            (0x5000_0000, 0x1000),
            (0xE000_1000, 0x1000),
            (0xE000_E000, 0x1000),
            (0xF000_0000, 0x1000),
        ] {
            uc.mmio_map(
                start.into(),
                len.into(),
                Some(move |uc: &mut Unicorn<'_, World>, offset: u64, size: usize| {
                    u64::from(uc.get_data_mut().soc.read(start + offset as u32, size as u32))
                }),
                Some(move |uc: &mut Unicorn<'_, World>, offset: u64, size: usize, value: u64| {
                    uc.get_data_mut().soc.write(start + offset as u32, value as u32, size as u32);
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

    fn hook(uc: &mut Unicorn<'static, World>, flash: &[u8]) {
        uc.add_block_hook(1, 0, |uc, address, size| {
            let address = address as u32;
            let world = uc.get_data_mut();
            let soc = &mut world.soc;
            let ready = soc.now >= soc.due || soc.nvic.reset_wanted || soc.nvmc.busy_until > soc.now;
            if ready || soc.nvic.any_ready() {
                let masked = !ready && {
                    let masked = uc.reg_read(RegisterARM::PRIMASK).unwrap_or(0) & 1 != 0;
                    let world = uc.get_data_mut();
                    masked || world.soc.nvic.next(0).is_none()
                };
                if !masked {
                    uc.get_data_mut().stop = Some(Stop::Attention { at: address });
                    let _ = uc.emu_stop();
                    return;
                }
            }
            let world = uc.get_data_mut();
            let soc = &mut world.soc;
            let count = match world.blocks.get_mut(address as usize / 2) {
                Some(&mut known @ 1..) => u64::from(known),
                Some(unknown) => {
                    let count = decode(&soc.flash, address, size);
                    *unknown = count as u16;
                    count
                }
                None => decode(&soc.flash, address, size),
            };
            if !world.open.is_empty() && soc.nvic.active().is_empty() {
                while let Some(&open) = world.open.last() {
                    if open.back != address {
                        break;
                    }
                    world.open.pop();
                    let instructions = world.thread_instructions - open.instructions_before;
                    let stack_bytes = if world.painting.contains(&open.probe) {
                        let below = world.soc.ram.get(open.stack_pointer - PAINTED as u32, PAINTED);
                        let clean = below.map_or(0, |b| b.iter().take_while(|&&byte| byte == PAINT).count());
                        (PAINTED - clean) as u32
                    } else {
                        0
                    };
                    world.calls[open.probe].push(Call { at: open.at, instructions, stack_bytes });
                }
            }
            if let Some(&(_, probe)) = world.probes.iter().rev().find(|(at, _)| *at == address) {
                let back = uc.reg_read(RegisterARM::LR).unwrap_or(0) as u32 & !1;
                let stack_pointer = uc.reg_read(RegisterARM::SP).unwrap_or(0) as u32;
                let world = uc.get_data_mut();
                if world.painting.contains(&probe) {
                    // What lies below the stack pointer is nobody's.
                    world.soc.ram.put(stack_pointer - PAINTED as u32, &[PAINT; PAINTED]);
                }
                let (at, instructions_before) = (world.soc.now, world.thread_instructions);
                world.open.push(Open { back, probe, at, instructions_before, stack_pointer });
            }
            let world = uc.get_data_mut();
            if let Some(&(_, tap, len)) = world.taps.iter().rev().find(|(at, ..)| *at == address) {
                let registers = [RegisterARM::R0, RegisterARM::R1, RegisterARM::R2, RegisterARM::R3]
                    .map(|r| uc.reg_read(r).unwrap_or(0) as u32);
                let bytes = uc.mem_read_as_vec(registers[0].into(), len).unwrap_or_default();
                let world = uc.get_data_mut();
                world.tapped[tap].push(Tapped { at: world.soc.now, registers, bytes });
            }
            let world = uc.get_data_mut();
            world.instructions += count;
            if world.soc.nvic.active().is_empty() {
                world.thread_instructions += count;
            }
            world.half += count * CYCLES_PER_TWO;
            let cycles = world.half / 2;
            world.half %= 2;
            world.executed += cycles;
            world.soc.now += cycles;
            world.soc.awake += cycles;
        })
        .expect("a hook");
        uc.add_intr_hook(|uc, number| {
            let pc = uc.reg_read(RegisterARM::PC).unwrap_or(0) as u32;
            uc.get_data_mut().stop = Some(match number {
                8 => Stop::ExceptionReturn,
                2 => Stop::Supervisor,
                _ => Stop::Fault(pc),
            });
            let _ = uc.emu_stop();
        })
        .expect("a hook");
        uc.add_mem_hook(HookType::MEM_INVALID, 1, 0, |uc, kind, address, size, value| {
            let world = uc.get_data_mut();
            world.bad_access = Some(format!("{kind:?} at {address:#x}, {size} bytes, {value:#x}"));
            false
        })
        .expect("a hook");
        // WFE, WFI, SEV and what masks interrupts, wherever they may stand.
        for (at, half) in flash.chunks_exact(2).enumerate() {
            let next = flash.get(at * 2 + 2..at * 2 + 4).map_or(0, |b| u16::from_le_bytes([b[0], b[1]]));
            let at = (at * 2) as u64;
            match u16::from_le_bytes([half[0], half[1]]) {
                0xBF20 | 0xBF30 => {
                    let for_event = half[0] == 0x20;
                    uc.add_code_hook(at, at, move |uc, address, _| {
                        uc.get_data_mut().stop = Some(Stop::Wait { at: address as u32, for_event });
                        let _ = uc.emu_stop();
                    })
                    .expect("a hook");
                }
                0xBF40 => {
                    uc.add_code_hook(at, at, |uc, _, _| uc.get_data_mut().event = true).expect("a hook");
                }
                // CPSID and CPSIE; MSR PRIMASK from a register.
                0xB672 | 0xB662 => {
                    let masks = half[0] == 0x72;
                    uc.add_code_hook(at, at, move |uc, _, _| uc.get_data_mut().mask(masks)).expect("a hook");
                }
                first @ 0xF380..=0xF38F if next == 0x8810 => {
                    let register = RegisterARM::R0 as i32 + i32::from(first & 0xF);
                    uc.add_code_hook(at, at, move |uc, _, _| {
                        let masks = uc.reg_read(register).unwrap_or(0) & 1 != 0;
                        uc.get_data_mut().mask(masks);
                    })
                    .expect("a hook");
                }
                _ => {}
            }
        }
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

    /// What the bootloader or the MBR does before the image's first instruction.
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
            // As the stock one leaves it: its own table stays, the converter and the cache are on.
            soc.write(0x4000_0578, 1, 4);
            soc.write(0x4001_E540, 1, 4);
            // UARTE0 receives into one byte of its RAM, which is ours now.
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

    /// Virtual time in cycles.
    pub fn now(&self) -> u64 {
        self.uc.get_data().soc.now
    }

    /// Cycle at which the firmware's clock (RTC1) was 0.
    pub fn clock_start(&self) -> u64 {
        super::time::cycle_of_tick(self.uc.get_data().soc.rtc1.zero_tick())
    }

    /// The processor waits for an event.
    pub fn is_asleep(&self) -> bool {
        self.asleep
    }

    /// Executed instructions.
    pub fn instructions(&self) -> u64 {
        self.uc.get_data().instructions
    }

    /// Cycles awake since power-up.
    pub fn awake(&self) -> u64 {
        self.uc.get_data().soc.awake
    }

    /// The image.
    pub fn image(&self) -> &Image {
        &self.image
    }

    /// Measures every call of a function from now on.
    pub fn probe(&mut self, function: &str) -> usize {
        let address = self.image.function(function);
        let world = self.uc.get_data_mut();
        world.calls.push(Vec::new());
        world.probes.push((address, world.calls.len() - 1));
        world.calls.len() - 1
    }

    /// As [`Self::probe`], and measures how deep the stack gets. Where such functions call each other, what the outer one
    /// did before the call is forgotten.
    pub fn probe_stack(&mut self, function: &str) -> usize {
        let probe = self.probe(function);
        self.uc.get_data_mut().painting.push(probe);
        probe
    }

    /// Calls measured so far.
    pub fn calls(&self, probe: usize) -> &[Call] {
        &self.uc.get_data().calls[probe]
    }

    /// Records arguments of a function at every call from now on, and `len` bytes behind the first one.
    pub fn tap(&mut self, function: &str, len: usize) -> usize {
        let address = self.image.function(function);
        let world = self.uc.get_data_mut();
        world.tapped.push(Vec::new());
        world.taps.push((address, world.tapped.len() - 1, len));
        world.tapped.len() - 1
    }

    /// What a tap has seen so far.
    pub fn tapped(&self, tap: usize) -> &[Tapped] {
        &self.uc.get_data().tapped[tap]
    }

    fn enter(&mut self, exception: usize) {
        let with_fp = self.reg(RegisterARM::CONTROL) & 4 != 0;
        let sp = self.reg(RegisterARM::SP);
        let xpsr = self.reg(RegisterARM::XPSR);
        let size = if with_fp { 0x68 } else { 0x20 };
        let frame = (sp - size) & !7;
        let aligned = u32::from(sp & 4 != 0);
        let registers = [
            RegisterARM::R0,
            RegisterARM::R1,
            RegisterARM::R2,
            RegisterARM::R3,
            RegisterARM::R12,
            RegisterARM::LR,
        ];
        let mut words: Vec<u32> = registers.iter().map(|&r| self.reg(r)).collect();
        words.push(self.reg(RegisterARM::PC) & !1);
        words.push(xpsr & !(1 << 9) & !0x1FF | aligned << 9 | (xpsr & 0x1FF));
        if with_fp {
            for i in 0..16 {
                words.push(self.uc.reg_read(RegisterARM::S0 as i32 + i).unwrap_or(0) as u32);
            }
            words.push(self.reg(RegisterARM::FPSCR));
            words.push(0);
        }
        let bytes: Vec<u8> = words.iter().flat_map(|w| w.to_le_bytes()).collect();
        self.uc.mem_write(frame.into(), &bytes).expect("the stack lies in RAM");
        let nested = !self.soc().nvic.active().is_empty();
        self.soc().nvic.enter(exception);
        let lr = match (with_fp, nested) {
            (false, false) => 0xFFFF_FFF9,
            (false, true) => 0xFFFF_FFF1,
            (true, false) => 0xFFFF_FFE9,
            (true, true) => 0xFFFF_FFE1u32,
        };
        let mut table = self.soc().nvic.vector_table;
        if self.boot == Boot::SoftDevice && table == 0 {
            // The table at 0 is the MBR's, which forwards to S140, which forwards to the application.
            table = APPLICATION;
            self.spend(FORWARD_CYCLES);
            let soc = self.soc();
            if let Some(softdevice) = soc.softdevice.as_mut().filter(|s| s.is_enabled()) {
                softdevice.rules.interrupt(exception - FIRST_IRQ, &soc.nvic);
            }
        }
        let vector = self.load(table + 4 * exception as u32);
        assert!(vector & 1 == 1, "exception {exception} has no handler in the table at {table:#x}");
        self.set_reg(RegisterARM::CONTROL, 0);
        self.set_reg(RegisterARM::SP, frame);
        self.set_reg(RegisterARM::XPSR, 1 << 24 | exception as u32);
        self.set_reg(RegisterARM::LR, lr);
        self.set_reg(RegisterARM::PC, vector);
        self.frames.push(with_fp);
        self.spend(EXCEPTION_CYCLES);
        self.uc.get_data_mut().event = true;
    }

    fn leave(&mut self) {
        let with_fp = self.frames.pop().expect("a handler ran");
        let frame = self.reg(RegisterARM::SP);
        let word = |board: &Self, i: u32| board.load(frame + 4 * i);
        let xpsr = word(self, 7);
        let size = if with_fp { 0x68 } else { 0x20 };
        let registers = [
            RegisterARM::R0,
            RegisterARM::R1,
            RegisterARM::R2,
            RegisterARM::R3,
            RegisterARM::R12,
            RegisterARM::LR,
        ];
        for (i, &register) in registers.iter().enumerate() {
            let value = word(self, i as u32);
            self.set_reg(register, value);
        }
        if with_fp {
            for i in 0..16 {
                let value = word(self, 8 + i);
                let _ = self.uc.reg_write(RegisterARM::S0 as i32 + i as i32, value.into());
            }
            let fpscr = word(self, 24);
            self.set_reg(RegisterARM::FPSCR, fpscr);
        }
        let pc = word(self, 6);
        self.soc().nvic.leave();
        self.set_reg(RegisterARM::XPSR, xpsr & !(1 << 9));
        self.set_reg(RegisterARM::CONTROL, if with_fp { 4 } else { 0 });
        self.set_reg(RegisterARM::SP, frame + size + (xpsr >> 9 & 1) * 4);
        self.set_reg(RegisterARM::PC, pc | 1);
        self.spend(EXCEPTION_CYCLES);
        self.uc.get_data_mut().event = true;
    }

    fn spend(&mut self, cycles: u64) {
        let soc = self.soc();
        soc.now += cycles;
        soc.awake += cycles;
    }

    /// Runs until this cycle of virtual time.
    ///
    /// # Panics
    /// Where the core faults; the message names the place.
    pub fn run_until(&mut self, until: u64) {
        while self.now() < until {
            if self.in_bootloader {
                self.wait_in_bootloader(until);
                continue;
            }
            let soc = self.soc();
            if soc.nvmc.busy_until > soc.now {
                // The core stands still while flash is written; interrupts wait.
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

    /// Time goes by in the stand-in bootloader, until a watchdog that the image left running bites.
    fn wait_in_bootloader(&mut self, until: u64) {
        // The UF2 bootloader feeds one that runs.
        let feeds = self.kind == Kind::Xiao;
        let soc = self.soc();
        let bite = soc.watchdog.due().filter(|&due| due <= until && !feeds);
        soc.now = soc.now.max(bite.unwrap_or(until));
        if bite.is_some() {
            self.in_bootloader = false;
            self.reset(WATCHDOG);
        }
    }

    /// Somebody presses the reset button.
    pub fn press_reset(&mut self) {
        self.in_bootloader = false;
        self.reset(PIN);
    }

    /// The slow crystal took longer to start than the stock bootloader waits: it leaves CLOCK's interrupt enabled.
    pub fn leave_clock_interrupt(&mut self) {
        self.slow_crystal = true;
        self.start();
    }

    /// The program finds itself at the start of this function.
    pub fn jump(&mut self, function: &str) {
        let address = self.image.function(function);
        self.set_reg(RegisterARM::PC, address | 1);
        self.asleep = false;
    }

    fn execute(&mut self, until: u64) {
        self.uc.get_data_mut().stop = None;
        // The end of the run is something due.
        let soc = self.soc();
        soc.due = soc.due.min(until);
        let pc = self.reg(RegisterARM::PC) | 1;
        let result = self.uc.emu_start(pc.into(), 0xFFFF_FFFF, 0, 0);
        let stop = self.uc.get_data_mut().stop.take();
        self.soc().settle();
        match stop {
            // The emulator's own program counter may lag behind between chained blocks.
            Some(Stop::Attention { at }) => self.set_reg(RegisterARM::PC, at | 1),
            Some(Stop::Wait { at, for_event }) => {
                self.set_reg(RegisterARM::PC, (at + 2) | 1);
                let event = std::mem::take(&mut self.uc.get_data_mut().event);
                self.asleep = if for_event { !event } else { !self.soc().nvic.any_ready() };
            }
            Some(Stop::ExceptionReturn) => self.leave(),
            Some(Stop::Supervisor) => self.supervisor_call(),
            Some(Stop::Fault(at)) => {
                panic!("the core faults at {at:#x}, lr {:#x}", self.reg(RegisterARM::LR))
            }
            None => {
                let at = self.reg(RegisterARM::PC);
                let access = self.uc.get_data().bad_access.clone();
                panic!(
                    "the core stops at {at:#x} (lr {:#x}): {result:?} {access:?}",
                    self.reg(RegisterARM::LR)
                )
            }
        }
    }

    /// S140's own interrupts end a sleep, and what breaks its rules ends the run.
    ///
    /// # Panics
    /// Where a rule of S140 is broken.
    fn softdevice_woke(&mut self) {
        let world = self.uc.get_data_mut();
        let Some(softdevice) = &mut world.soc.softdevice else { return };
        world.event |= std::mem::take(&mut softdevice.woke);
        if let Some(broken) = softdevice.rules.broken() {
            let broken = broken.to_string();
            panic!("a rule of S140 is broken near {:#x}: {broken}", self.reg(RegisterARM::PC));
        }
    }

    fn supervisor_call(&mut self) {
        let pc = self.reg(RegisterARM::PC) & !1;
        let number = (self.load((pc - 2) & !3) >> (8 * ((pc - 2) & 3))) as u8;
        let core = Core {
            args: [RegisterARM::R0, RegisterARM::R1, RegisterARM::R2, RegisterARM::R3].map(|r| self.reg(r)),
            sp: self.reg(RegisterARM::SP),
            masked: self.reg(RegisterARM::PRIMASK) & 1 != 0,
            statics_end: self.image.symbols.get("__sheap").copied().unwrap_or(RAM_START),
        };
        let soc = self.soc();
        let Some(mut softdevice) = soc.softdevice.take() else {
            panic!("SVC {number} at {pc:#x} without S140");
        };
        let answer = softdevice.call(number, core, soc);
        soc.softdevice = Some(softdevice);
        soc.settle();
        self.set_reg(RegisterARM::R0, answer);
        self.set_reg(RegisterARM::PC, pc | 1);
        self.spend(super::softdevice::rules::CALL_CYCLES);
        self.uc.get_data_mut().event = true;
    }

    /// S140 below the image.
    ///
    /// # Panics
    /// Where the image does not run behind S140.
    pub fn softdevice(&mut self) -> &mut SoftDevice {
        self.soc().softdevice.as_mut().expect("the image runs behind S140")
    }

    /// Runs for so many milliseconds of virtual time.
    pub fn run_ms(&mut self, milliseconds: u64) {
        let until = self.now() + us(milliseconds * 1000);
        self.run_until(until);
    }

    /// Share of time awake so far, 0 to 1.
    pub fn awake_share(&self) -> f64 {
        self.awake() as f64 / self.now().max(1) as f64
    }

    /// Seconds of virtual time.
    pub fn seconds(&self) -> f64 {
        self.now() as f64 / HZ as f64
    }

    /// Bytes that left D0 since the last call.
    pub fn uart_out(&mut self) -> Vec<u8> {
        self.soc().uart.take_sent().into_iter().map(|(_, byte)| byte).collect()
    }

    /// Sends bytes into D1.
    pub fn uart_in(&mut self, bytes: &[u8]) {
        let soc = self.soc();
        soc.uart.receive(bytes, soc.now);
        soc.settle();
    }

    /// Handler address of an interrupt in the linked table.
    pub fn vector(&self, irq: usize) -> u32 {
        self.load(self.image.vector_table + 4 * (FIRST_IRQ + irq) as u32)
    }
}
