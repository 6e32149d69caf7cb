//! simavr's callbacks for the pins, the serial line, the converter and the EEPROM.

use super::*;

impl Wires {
    pub(super) fn cycle(&self) -> u64 {
        // Safety: the emulator outlives its callbacks.
        self.before_reset.get() + unsafe { (*self.avr).cycle }
    }
}

/// Lets the core sleep for this many cycles, unless SMCR.SE is clear and SLEEP has no effect.
pub(super) unsafe extern "C" fn on_sleep(avr: *mut ffi::avr_t, clocks: u64) {
    // SAFETY: simavr passes the running core.
    unsafe {
        if *(*avr).data.add(SMCR) & 1 != 0 {
            ASLEEP.set(ASLEEP.get() + clocks + 1);
        } else {
            (*avr).state = ffi::cpu_Running as i32;
            // simavr adds the cycles afterwards.
            (*avr).cycle = (*avr).cycle.wrapping_sub(clocks);
        }
    }
}

pub(super) unsafe extern "C" fn on_heartbeat(_: *mut ffi::avr_t, _: u64, _: *mut c_void) -> u64 {
    0
}

/// # Safety
/// `param` must be the boxed [`Wires`] of the calling board. This applies to all callbacks here.
unsafe fn wires<'a>(param: *mut c_void) -> &'a Wires {
    // SAFETY: guaranteed by the caller; the board outlives its callbacks.
    unsafe { &*param.cast::<Wires>() }
}

pub(super) unsafe extern "C" fn on_sent(_: *mut ffi::avr_irq_t, value: u32, param: *mut c_void) {
    // SAFETY: this callback was registered with the board's wires as its parameter.
    let wires = unsafe { wires(param) };
    // The callback occurs when the program writes the byte, which is sent within one byte time.
    // If the previous byte is still being sent, this takes two byte times, and the previous byte's time stamp delays ours.
    const CYCLES_ON_WIRE: u64 = 10 * 8 * 17;
    let mut sent = wires.sent.borrow_mut();
    let start = sent.back().map_or(0, |&(at, _)| at).max(wires.cycle());
    sent.push_back((start + CYCLES_ON_WIRE, value as u8));
}

pub(super) unsafe extern "C" fn on_byte_due(avr: *mut ffi::avr_t, when: u64, param: *mut c_void) -> u64 {
    // SAFETY: this callback was registered with the board's wires as its parameter.
    let wires = unsafe { wires(param) };
    let due = wires.to_receive.borrow_mut().pop_front();
    if let Some((_, byte)) = due {
        // SAFETY: simavr passes the running core, whose UART has this line.
        unsafe {
            let uart = ffi::avr_io_getirq(avr, ioctl(b"uar0"), ffi::UART_IRQ_INPUT as i32);
            ffi::avr_raise_irq(uart, u32::from(byte));
        }
    }
    if wires.to_receive.borrow().is_empty() { 0 } else { when + CYCLES_PER_BYTE }
}

pub(super) unsafe extern "C" fn on_conversion(irq: *mut ffi::avr_irq_t, value: u32, param: *mut c_void) {
    // SAFETY: this callback was registered with the board's wires as its parameter.
    let wires = unsafe { wires(param) };
    wires.conversions.set(wires.conversions.get() + 1);
    // struct avr_adc_mux_t { unsigned long kind : 3, gain : 8, diff : 8, src : 13; }
    let (kind, source) = (value & 7, value >> 19);
    if kind == ffi::ADC_MUX_SINGLE {
        let pin = source as u8;
        match wires.voltages.borrow_mut().at(pin, wires.cycle()) {
            PinInput::Millivolts(mv) => wires.held_mv.set(mv),
            PinInput::Open => {}
        }
        let mv = wires.held_mv.get().clamp(0.0, 5000.0).round() as u32;
        // Safety: the input pins are before this one in simavr's array.
        unsafe {
            ffi::avr_raise_irq(irq.sub(ffi::ADC_IRQ_OUT_TRIGGER as usize).add(pin as usize), mv);
        }
    } else {
        wires.held_mv.set(0.0); // ground
    }
}

pub(super) unsafe extern "C" fn on_admux(_: *mut ffi::avr_irq_t, value: u32, param: *mut c_void) {
    // SAFETY: this callback was registered with the board's wires as its parameter.
    let wires = unsafe { wires(param) };
    if value >> 6 & 3 != 0 {
        wires.wrong_reference.set(Some(value as u8));
    }
}

pub(super) unsafe extern "C" fn on_eecr(_: *mut ffi::avr_irq_t, value: u32, param: *mut c_void) {
    const EEPE: u32 = 1 << 1;
    const EEARL: usize = 0x41;
    const EEDR: usize = 0x40;
    // SAFETY: this callback was registered with the board's wires as its parameter.
    let wires = unsafe { wires(param) };
    if value & EEPE != 0 {
        // SAFETY: both registers are in data space.
        let data = |address: usize| unsafe { *(*wires.avr).data.add(address) };
        let address = u16::from(data(EEARL)) | u16::from(data(EEARL + 1)) << 8;
        let new = data(EEDR);
        let place = address as usize % EEPROM_BYTES;
        let old = std::mem::replace(&mut wires.eeprom.borrow_mut()[place], new);
        // simavr calls this twice per write, and the second call changes nothing.
        if old != new {
            wires.eeprom_writes.borrow_mut().push(EepromWrite { address, old, new });
        }
    }
}
