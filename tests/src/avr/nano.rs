//! An Arduino Nano in simavr: Vcc 5.0 V, AREF 3.3 V, 16 MHz.
//!
//! simavr synchronises a sleeping program with the wall clock.
//! Here, its sleep callback does nothing, so virtual time runs as fast as possible.
//! simavr differs from the chip in several ways.
//! A UART byte takes 11 bit times instead of 10, so our latencies are slightly too large.
//! An EEPROM byte is written immediately, and a reset sets the cycle counter to 0 (we keep the total).
//! This module corrects two errors of simavr. The first is that it sleeps even if SMCR.SE is clear.
//! The second is that an interrupting watchdog never resets a program that has disabled interrupts.

mod callbacks;

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::ffi::{CString, c_void};
use std::path::Path;
use std::ptr::null_mut;

use callbacks::*;
use simavr_ffi as ffi;

/// Clock of the Nano.
pub const CYCLES_PER_MS: u64 = 16_000;
/// Number of cycles per byte at 115200 baud. A bit takes 136 cycles, and simavr uses 11 bits per byte.
const CYCLES_PER_BYTE: u64 = 11 * 8 * 17;
/// Number of cycles between two checks for events. After a reset, the count is too low by about this number.
const CYCLES_AT_ONCE: u64 = 160;
/// Bytes of EEPROM.
pub const EEPROM_BYTES: usize = 1024;
/// Addresses of registers in the data space.
const ADMUX: u16 = 0x7C;
const EECR: u16 = 0x3F;
const SMCR: usize = 0x53;
const MCUSR: usize = 0x54;
const WDTCSR: usize = 0x60;
/// RAM begins after the registers.
const RAM: std::ops::Range<usize> = 0x100..0x900;

/// The signal at an analog pin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PinInput {
    /// A source, in millivolts.
    Millivolts(f64),
    /// The pin is not connected, and the converter keeps its last value.
    Open,
}

/// The signals at the analog pins.
pub trait Voltages {
    /// Returns the signal at pin A`pin` (0..=4), at `cycle` clocks since power-on.
    fn at(&mut self, pin: u8, cycle: u64) -> PinInput;
}

impl<F: FnMut(u8, u64) -> PinInput> Voltages for F {
    fn at(&mut self, pin: u8, cycle: u64) -> PinInput {
        self(pin, cycle)
    }
}

/// A byte of EEPROM that the program has written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EepromWrite {
    /// Address of the byte.
    pub address: u16,
    /// The value before.
    pub old: u8,
    /// The value afterwards.
    pub new: u8,
}

/// Data shared by simavr's callbacks and the board.
/// The data is in cells, because callbacks run inside the emulator, and never at the same time as our own code.
struct Wires {
    avr: *mut ffi::avr_t,
    voltages: RefCell<Box<dyn Voltages>>,
    /// Voltage of the capacitor in the converter, in millivolts.
    held_mv: Cell<f64>,
    sent: RefCell<VecDeque<(u64, u8)>>,
    to_receive: RefCell<VecDeque<(u64, u8)>>,
    wrong_reference: Cell<Option<u8>>,
    eeprom: RefCell<Vec<u8>>,
    eeprom_writes: RefCell<Vec<EepromWrite>>,
    /// Clock cycles counted before the last reset.
    before_reset: Cell<u64>,
    conversions: Cell<u64>,
}

thread_local! {
    /// The number of sleep cycles of this thread's board (simavr's sleep callback has no parameter).
    static ASLEEP: Cell<u64> = const { Cell::new(0) };
}

/// The emulated board.
pub struct Nano {
    avr: *mut ffi::avr_t,
    wires: Box<Wires>,
    resets: u32,
    asleep: u64,
    optiboot: bool,
    /// The time since which the watchdog's interrupt has been pending.
    waiting_since: Option<u64>,
}

const fn ioctl(name: &[u8; 4]) -> u32 {
    u32::from_be_bytes(*name)
}

impl Nano {
    /// Powers a board with this image, EEPROM content and wiring.
    pub fn new(image: &Path, eeprom: &[u8; EEPROM_BYTES], voltages: Box<dyn Voltages>) -> Self {
        let name = CString::new("atmega328p").expect("no zero in it");
        let path = CString::new(image.to_str().expect("a path in UTF-8")).expect("no zero in a path");
        // Safety: this is simavr's documented order (make, init, load), and all pointers live long enough.
        unsafe {
            let avr = ffi::avr_make_mcu_by_name(name.as_ptr());
            assert!(!avr.is_null(), "simavr knows the ATmega328P");
            assert_eq!(ffi::avr_init(avr), 0);
            let mut firmware: ffi::elf_firmware_t = std::mem::zeroed();
            assert_eq!(ffi::elf_read_firmware(path.as_ptr(), &mut firmware), 0, "{}", image.display());
            firmware.frequency = 16_000_000;
            firmware.vcc = 5000;
            firmware.avcc = 5000;
            firmware.aref = 3300;
            ffi::avr_load_firmware(avr, &mut firmware);
            (*avr).sleep = Some(on_sleep);
            // After power-on, RAM contains arbitrary values.
            for address in RAM {
                *(*avr).data.add(address) = (address as u8).wrapping_mul(37) ^ 0x5A;
            }
            let wires = Box::new(Wires {
                avr,
                voltages: RefCell::new(voltages),
                held_mv: Cell::new(0.0),
                sent: RefCell::default(),
                to_receive: RefCell::default(),
                wrong_reference: Cell::new(None),
                eeprom: RefCell::new(eeprom.to_vec()),
                eeprom_writes: RefCell::default(),
                before_reset: Cell::new(0),
                conversions: Cell::new(0),
            });
            let nano = Self { avr, wires, resets: 0, asleep: 0, optiboot: false, waiting_since: None };
            nano.connect();
            nano.set_eeprom(eeprom);
            nano
        }
    }

    /// # Safety
    /// `avr` must be initialised, and the boxed wires must outlive it.
    unsafe fn connect(&self) {
        let param = std::ptr::from_ref::<Wires>(&self.wires).cast_mut().cast::<c_void>();
        // SAFETY: guaranteed by the caller.
        unsafe {
            let mut flags: u32 = 0; // neither echo to the terminal nor naps while polled
            ffi::avr_ioctl(self.avr, ioctl(b"uas0"), (&raw mut flags).cast());
            let uart = ffi::avr_io_getirq(self.avr, ioctl(b"uar0"), ffi::UART_IRQ_OUTPUT as i32);
            ffi::avr_irq_register_notify(uart, Some(on_sent), param);
            let adc = ffi::avr_io_getirq(self.avr, ioctl(b"adc0"), ffi::ADC_IRQ_OUT_TRIGGER as i32);
            ffi::avr_irq_register_notify(adc, Some(on_conversion), param);
            let all = ffi::AVR_IOMEM_IRQ_ALL as i32;
            let admux = ffi::avr_iomem_getirq(self.avr, ADMUX, null_mut(), all);
            ffi::avr_irq_register_notify(admux, Some(on_admux), param);
            let eecr = ffi::avr_iomem_getirq(self.avr, EECR, null_mut(), all);
            ffi::avr_irq_register_notify(eecr, Some(on_eecr), param);
        }
    }

    /// Number of cycles since power-on, including all resets.
    pub fn cycle(&self) -> u64 {
        self.wires.cycle()
    }

    /// Milliseconds since power-on.
    pub fn now_ms(&self) -> f64 {
        self.cycle() as f64 / CYCLES_PER_MS as f64
    }

    /// Runs until `cycle` cycles after power-on.
    ///
    /// # Panics
    /// Panics if the program crashes, stops permanently, or selects a wrong reference for the converter.
    pub fn run_until(&mut self, cycle: u64) {
        let mut last = self.cycle();
        let mut has_heartbeat = false;
        while last < cycle {
            // Safety: the board is alive, and the callbacks receive the boxed wires.
            let state = unsafe {
                if !has_heartbeat {
                    // A sleeping program must be woken in time.
                    ffi::avr_cycle_timer_register(self.avr, cycle - last, Some(on_heartbeat), null_mut());
                    (*self.avr).run_cycle_limit = CYCLES_AT_ONCE;
                    has_heartbeat = true;
                }
                ffi::avr_run(self.avr)
            };
            assert!(
                state != ffi::cpu_Done as i32 && state != ffi::cpu_Crashed as i32,
                "the program ended (state {state}) at {:.1} ms",
                self.now_ms()
            );
            self.asleep += ASLEEP.replace(0);
            self.watchdog_interrupt_must_not_wait();
            // SAFETY: the board is alive.
            let now = unsafe { (*self.avr).cycle };
            if now + self.wires.before_reset.get() < last {
                self.wires.before_reset.set(last);
                self.resets += 1;
                has_heartbeat = false;
                self.waiting_since = None;
                self.pass_optiboot();
                // The reset has deleted the timers, so bytes in transit to the board are lost.
                self.wires.to_receive.borrow_mut().clear();
            }
            last = self.cycle();
        }
        if let Some(admux) = self.wires.wrong_reference.get() {
            panic!("ADMUX = {admux:#04x}: any reference but AREF shorts the board's 3.3 V");
        }
    }

    /// Runs for some time.
    pub fn run_ms(&mut self, ms: f64) {
        self.run_until(self.cycle() + (ms * CYCLES_PER_MS as f64) as u64);
    }

    /// If the watchdog's interrupt is not handled before the next time-out, that time-out resets the chip
    /// ("Interrupt and System Reset Mode" in the data sheet).
    fn watchdog_interrupt_must_not_wait(&mut self) {
        const WDIF: u8 = 1 << 7;
        const WDIE: u8 = 1 << 6;
        const WDE: u8 = 1 << 3;
        let control = self.peek(WDTCSR);
        if control & (WDIF | WDIE | WDE) != WDIF | WDIE | WDE {
            self.waiting_since = None;
            return;
        }
        let since = *self.waiting_since.get_or_insert(self.cycle());
        let timeout = (2048 << (control & 7)) * CYCLES_PER_MS / 128;
        if self.cycle() + 10 * CYCLES_AT_ONCE >= since + timeout {
            self.poke(WDTCSR, control & !WDIE);
        }
    }

    /// Simulates Optiboot 4.4 between a reset and the program.
    fn pass_optiboot(&mut self) {
        if self.optiboot {
            self.poke(MCUSR, 0);
            // The stack of the bootloader.
            for address in RAM.end - 8..RAM.end {
                self.poke(address, 0x0B);
            }
        }
    }

    /// Simulates Optiboot, which hides the cause of a reset from the program.
    pub fn pretend_optiboot(&mut self) {
        self.optiboot = true;
        self.pass_optiboot();
    }

    /// Number of sleep cycles since power-on.
    pub fn asleep(&self) -> u64 {
        self.asleep
    }

    /// Returns whether the instruction SLEEP is enabled (SMCR.SE).
    pub fn may_sleep(&self) -> bool {
        self.peek(SMCR) & 1 != 0
    }

    /// Number of watchdog resets so far.
    pub fn resets(&self) -> u32 {
        self.resets
    }

    /// Number of conversions so far.
    pub fn conversions(&self) -> u64 {
        self.wires.conversions.get()
    }

    /// Returns the next byte from the board, with the cycle of its last bit.
    pub fn sent(&mut self) -> Option<(u64, u8)> {
        self.wires.sent.borrow_mut().pop_front()
    }

    /// Returns the bytes whose last bit was sent by this cycle; later bytes remain for the next call.
    pub fn sent_until(&mut self, cycle: u64) -> Vec<u8> {
        let mut queue = self.wires.sent.borrow_mut();
        let count = queue.partition_point(|&(at, _)| at <= cycle);
        queue.drain(..count).map(|(_, byte)| byte).collect()
    }

    /// Sends bytes to the board without pauses, after all earlier bytes.
    pub fn send(&mut self, bytes: &[u8]) {
        let mut queue = self.wires.to_receive.borrow_mut();
        let was_empty = queue.is_empty();
        let mut at = queue.back().map_or(self.cycle(), |&(at, _)| at.max(self.cycle()));
        for &byte in bytes {
            at += CYCLES_PER_BYTE;
            queue.push_back((at, byte));
        }
        if was_empty && !bytes.is_empty() {
            let param = std::ptr::from_ref::<Wires>(&self.wires).cast_mut().cast::<c_void>();
            // Safety: the wires outlive the emulator.
            unsafe {
                ffi::avr_cycle_timer_register(self.avr, CYCLES_PER_BYTE, Some(on_byte_due), param);
            }
        }
    }

    /// Number of bytes that have not reached the board yet.
    pub fn unsent(&self) -> usize {
        self.wires.to_receive.borrow().len()
    }

    /// Replaces the signals at the analog pins.
    pub fn set_voltages(&mut self, voltages: Box<dyn Voltages>) {
        *self.wires.voltages.borrow_mut() = voltages;
    }

    /// Connects D2 to ground, or disconnects it.
    pub fn hold_calibration_pin(&mut self, held: bool) {
        // struct avr_ioport_external_t { unsigned long name : 7, mask : 8, value : 8; }
        let mut external: u64 = if held { (1 << 2) << 7 } else { 0 };
        // Safety: the parameter has the type of this call.
        let result = unsafe { ffi::avr_ioctl(self.avr, ioctl(b"iopD"), (&raw mut external).cast()) };
        assert_eq!(result, 0);
    }

    /// Pulls the reset line, like the button or a laptop that opens the port.
    pub fn reset(&mut self) {
        const EXTRF: u8 = 1 << 1;
        self.poke(MCUSR, self.peek(MCUSR) | EXTRF);
        let before = self.cycle();
        // Safety: the emulator is not running.
        unsafe { ffi::avr_reset(self.avr) };
        self.wires.before_reset.set(before);
        self.wires.to_receive.borrow_mut().clear();
        self.pass_optiboot();
    }

    /// Writes bytes to the start of the old bootloader, so that the program detects an old bootloader.
    pub fn pretend_old_bootloader(&mut self) {
        const OLD_BOOTLOADER: usize = 0x7800;
        // Safety: the write is within the 32 KB of flash.
        unsafe { *(*self.avr).flash.add(OLD_BOOTLOADER) = 0x0C }
    }

    /// Returns whether the light (D13) is on.
    pub fn light(&self) -> bool {
        const PORTB: usize = 0x25;
        self.peek(PORTB) & (1 << 5) != 0
    }

    /// Reads the data space, which contains registers and RAM.
    pub fn peek(&self, address: usize) -> u8 {
        assert!(address < RAM.end);
        // Safety: the access is within data space.
        unsafe { *(*self.avr).data.add(address) }
    }

    /// Writes the data space without the program's knowledge.
    pub fn poke(&mut self, address: usize, value: u8) {
        assert!(address < RAM.end);
        // Safety: the access is within data space.
        unsafe { *(*self.avr).data.add(address) = value }
    }

    /// Makes the program jump to an address.
    pub fn jump(&mut self, address: u32) {
        // Safety: the emulator is not running.
        unsafe {
            (*self.avr).pc = address;
            (*self.avr).state = ffi::cpu_Running as i32;
        }
    }

    /// Makes the board execute `sts address, value` and then nothing else, as a program with an error might do.
    pub fn execute_sts(&mut self, address: u16, value: u8) {
        const UNUSED_FLASH: usize = 0x7000;
        const R16: usize = 16;
        let [low, high] = address.to_le_bytes();
        // The code is `sts address, r16` and `rjmp .-2`.
        let code = [0x00, 0x93, low, high, 0xFF, 0xCF];
        for (i, byte) in code.into_iter().enumerate() {
            // Safety: the address is within the 32 KB of flash.
            unsafe { *(*self.avr).flash.add(UNUSED_FLASH + i) = byte }
        }
        self.poke(R16, value);
        self.jump(UNUSED_FLASH as u32);
    }

    /// Returns the content of the whole EEPROM.
    pub fn eeprom(&self) -> [u8; EEPROM_BYTES] {
        let mut bytes = [0; EEPROM_BYTES];
        let mut what =
            ffi::avr_eeprom_desc_t { ee: bytes.as_mut_ptr(), offset: 0, size: EEPROM_BYTES as u32 };
        // Safety: the buffer has the given length.
        let result = unsafe { ffi::avr_ioctl(self.avr, ioctl(b"eegp"), (&raw mut what).cast()) };
        assert_eq!(result, 0);
        bytes
    }

    fn set_eeprom(&self, bytes: &[u8; EEPROM_BYTES]) {
        let mut copy = *bytes;
        let mut what = ffi::avr_eeprom_desc_t { ee: copy.as_mut_ptr(), offset: 0, size: EEPROM_BYTES as u32 };
        // Safety: the buffer has the given length.
        let result = unsafe { ffi::avr_ioctl(self.avr, ioctl(b"eesp"), (&raw mut what).cast()) };
        assert_eq!(result, 0);
    }

    /// Returns all writes to EEPROM since power-on, in order.
    pub fn eeprom_writes(&self) -> Vec<EepromWrite> {
        self.wires.eeprom_writes.borrow().clone()
    }

    /// Number of bytes written to EEPROM since power-on.
    pub fn eeprom_write_count(&self) -> usize {
        self.wires.eeprom_writes.borrow().len()
    }

    /// Returns the number of bytes of RAM from `from` on that still contain `paint`.
    pub fn painted(&self, from: usize, paint: u8) -> usize {
        (from..RAM.end).take_while(|&address| self.peek(address) == paint).count()
    }
}

impl Drop for Nano {
    fn drop(&mut self) {
        // Safety: simavr allocated this memory, and it is not used afterwards.
        // (The core itself is a plain allocation.)
        unsafe {
            ffi::avr_terminate(self.avr);
            libc_free(self.avr.cast());
        }
    }
}

unsafe extern "C" {
    #[link_name = "free"]
    fn libc_free(pointer: *mut c_void);
}
