//! Core functions that unicorn lacks: exceptions, sleep and supervisor calls.

use super::super::controller::{CALL_CYCLES, Then};
use super::*;

/// The registers that the processor stacks first, in this order (ARMv7-M, B1.5.6).
const STACKED: [RegisterARM; 6] =
    [RegisterARM::R0, RegisterARM::R1, RegisterARM::R2, RegisterARM::R3, RegisterARM::R12, RegisterARM::LR];

/// Value of CONTROL with an active floating-point unit: FPCA and SFPA.
/// Unicorn treats all code as secure.
/// Without SFPA, the next floating-point instruction would therefore start a new context and clear the flags.
const FP_IN_USE: u32 = 1 << 2 | 1 << 3;

/// A jump to this address or to a higher address ends a handler.
const EXCEPTION_RETURNS: u32 = 0xFFFF_FF00;

/// Size in bytes of a frame on the stack, with and without the registers of the floating-point unit.
fn frame_bytes(with_fp: bool) -> u32 {
    if with_fp { 0x68 } else { 0x20 }
}

impl Board {
    pub(super) fn enter(&mut self, exception: usize) {
        let with_fp = self.reg(RegisterARM::CONTROL) & 4 != 0;
        let sp = self.reg(RegisterARM::SP);
        let xpsr = self.reg(RegisterARM::XPSR);
        let size = frame_bytes(with_fp);
        let frame = (sp - size) & !7;
        let aligned = u32::from(sp & 4 != 0);
        let mut words: Vec<u32> = STACKED.iter().map(|&r| self.reg(r)).collect();
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
            // The MBR owns the table at 0.
            // The MBR forwards exceptions to S140, and S140 forwards them to the application.
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

    pub(super) fn leave(&mut self) {
        let with_fp = self.frames.pop().expect("a handler ran");
        let frame = self.reg(RegisterARM::SP);
        let word = |board: &Self, i: u32| board.load(frame + 4 * i);
        let xpsr = word(self, 7);
        let size = frame_bytes(with_fp);
        for (i, &register) in STACKED.iter().enumerate() {
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
        self.set_reg(RegisterARM::CONTROL, if with_fp { FP_IN_USE } else { 0 });
        self.set_reg(RegisterARM::SP, frame + size + (xpsr >> 9 & 1) * 4);
        self.set_reg(RegisterARM::PC, pc | 1);
        self.spend(EXCEPTION_CYCLES);
        self.uc.get_data_mut().event = true;
    }

    pub(super) fn spend(&mut self, cycles: u64) {
        let soc = self.soc();
        soc.now += cycles;
        soc.awake += cycles;
    }

    pub(super) fn execute(&mut self, until: u64) {
        self.uc.get_data_mut().stop = None;
        // The requested end of the run also counts as an event.
        let soc = self.soc();
        soc.due = soc.due.min(until);
        let pc = self.reg(RegisterARM::PC) | 1;
        let result = self.uc.emu_start(pc.into(), 0xFFFF_FFFF, 0, 0);
        let stop = self.uc.get_data_mut().stop.take();
        self.soc().settle();
        match stop {
            // Between chained blocks, the emulator's own program counter may be outdated.
            Some(Stop::Attention { at }) => self.set_reg(RegisterARM::PC, at | 1),
            Some(Stop::Wait { at, for_event }) => {
                self.set_reg(RegisterARM::PC, (at + 2) | 1);
                let event = std::mem::take(&mut self.uc.get_data_mut().event);
                self.asleep = if for_event { !event } else { !self.soc().nvic.any_ready() };
            }
            Some(Stop::ExceptionReturn) => self.leave(),
            Some(Stop::Supervisor) => self.supervisor_call(),
            Some(Stop::Function(at)) => self.function_called(at),
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

    /// S140's own interrupts end a sleep. If the image violates S140's rules, the run ends.
    ///
    /// # Panics
    /// Panics if the image has violated a rule of S140.
    pub(super) fn softdevice_woke(&mut self) {
        let world = self.uc.get_data_mut();
        let Some(softdevice) = &mut world.soc.softdevice else { return };
        world.event |= std::mem::take(&mut softdevice.woke);
        if let Some(broken) = softdevice.rules.broken() {
            let broken = broken.to_string();
            panic!("a rule of S140 is broken near {:#x}: {broken}", self.reg(RegisterARM::PC));
        }
    }

    /// Begins a function of Nordic's controller.
    /// If a callback has returned, continues the function that called it.
    pub(super) fn function_called(&mut self, at: u32) {
        let args = [RegisterARM::R0, RegisterARM::R1, RegisterARM::R2, RegisterARM::R3].map(|r| self.reg(r));
        let lr = self.reg(RegisterARM::LR);
        let soc = self.soc();
        let mut controller = soc.controller.take().expect("it marked this address");
        let then = controller.call(at, lr, args, soc);
        let broken = controller.broken.first().cloned();
        soc.controller = Some(controller);
        soc.settle();
        if let Some(broken) = broken {
            panic!("a rule of Nordic's libraries is broken near {lr:#x}: {broken}");
        }
        match then {
            // A handler of the image jumped to this function, whose return therefore ends the exception.
            Then::Return { to, .. } if to >= EXCEPTION_RETURNS => self.leave(),
            Then::Return { value, to } => {
                self.set_reg(RegisterARM::R0, value);
                self.set_reg(RegisterARM::PC, to | 1);
            }
            Then::Run => {
                self.uc.get_data_mut().passes = Some(at);
                self.set_reg(RegisterARM::PC, at | 1);
                return;
            }
            Then::CallBack { function, arguments } => {
                self.set_reg(RegisterARM::R0, arguments[0]);
                self.set_reg(RegisterARM::R1, arguments[1]);
                self.set_reg(RegisterARM::LR, at | 1);
                self.set_reg(RegisterARM::PC, function | 1);
            }
        }
        self.spend(CALL_CYCLES);
    }

    pub(super) fn supervisor_call(&mut self) {
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
        self.spend(super::super::softdevice::rules::CALL_CYCLES);
        self.uc.get_data_mut().event = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nrf::lsm9ds1::Still;
    use crate::nrf::memory::RAM_START;

    /// Compares 1.0 with 2.0 and is interrupted by SWI0 before the result is read.
    const COMPARE_AND_BE_INTERRUPTED: [u16; 32] = [
        0x22E0, 0x0612, // r2 = 0xE0000000
        0xF64E, 0x5388, 0x240F, 0x0524, 0x50D4, // CPACR, at 0xED88 from there: the unit may be used
        0x23E1, 0x021B, 0x2401, 0x0524, 0x50D4, // interrupt 20 is enabled
        0x23E2, 0x021B, // where one is asked for
        0xEEB7, 0x0A00, 0xEEF0, 0x0A00, 0xEEB4, 0x0A60, // s0 = 1, s1 = 2, vcmp s0, s1
        0x50D4, 0xE7FF, // asked for; the next block begins
        0xEEF1, 0xFA10, // vmrs APSR_nzcv, fpscr
        0xD401, 0x2002, 0xE000, 0x2001, // r0 = 1 where less, else 2
        0x2320, 0x061B, 0x6018, 0xE7FE, // r0 goes to the start of RAM; stay
    ];

    /// The interrupt also performs a comparison (vcmp s1, s1), and then stores the result in r4.
    const COMPARE_ALSO: [u16; 6] = [0xEEF4, 0x0A60, 0x2120, 0x0609, 0x604C, 0x4770];

    #[test]
    fn what_a_comparison_found_outlives_an_interrupt() {
        let mut bytes = vec![0; 0x100];
        bytes[..4].copy_from_slice(&0x2004_0000u32.to_le_bytes());
        bytes[4..8].copy_from_slice(&(APPLICATION + 0x101).to_le_bytes());
        let handler = APPLICATION + 0x101 + 2 * COMPARE_AND_BE_INTERRUPTED.len() as u32;
        bytes[4 * 36..4 * 37].copy_from_slice(&handler.to_le_bytes());
        let code = COMPARE_AND_BE_INTERRUPTED.iter().chain(&COMPARE_ALSO);
        bytes.extend(code.flat_map(|half| half.to_le_bytes()));
        let image =
            Image { pieces: vec![(APPLICATION, bytes)], vector_table: APPLICATION, ..Image::default() };
        let mut board = Board::new(image, Boot::SoftDevice, Box::new(Still));
        board.run_ms(2);
        assert_eq!(board.soc().ram.word(RAM_START + 4), 1 << 20, "the interrupt came");
        assert_eq!(board.soc().ram.word(RAM_START), 1, "1.0 is less than 2.0");
    }
}
