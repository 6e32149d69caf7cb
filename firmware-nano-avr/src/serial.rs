//! Drives the serial line to the laptop (USART0) with two ring buffers that interrupts fill and empty.
//!
//! Only [`Read`] and [`Write`] wait if the line is not ready, because their contracts require this.
//! The firmware checks [`ReadReady`] and [`room`] first and therefore never waits.

use avr_device::atmega328p::Peripherals;
use avr_device::interrupt::{self, Mutex};
use core::cell::{Cell, RefCell};
use core::convert::Infallible;
use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use heapless::Deque;

#[cfg(any(
    all(feature = "baud-57600", feature = "baud-115200"),
    all(feature = "baud-57600", feature = "baud-250000"),
    all(feature = "baud-115200", feature = "baud-250000"),
    not(any(feature = "baud-57600", feature = "baud-115200", feature = "baud-250000")),
))]
compile_error!("choose one serial speed: --no-default-features --features baud-57600 (or -115200, -250000)");

/// Bits per second.
const BAUD: u32 = if cfg!(feature = "baud-57600") {
    57_600
} else if cfg!(feature = "baud-250000") {
    250_000
} else {
    115_200
};
/// With U2X, the line sends one bit in 8·(UBRR + 1) clocks.
/// After rounding, 57600 baud is 0.8 % slow, 115200 is 2.1 % fast, and 250000 is exact.
const UBRR: u16 = ((16_000_000 / 8 + BAUD / 2) / BAUD - 1) as u16;
const _: () = assert!(UBRR == 34 || UBRR == 16 || UBRR == 7);

/// The buffer holds the bytes that arrive while a frame is computed (less than 3 ms, at most 11 bytes per ms).
static RECEIVED: Mutex<RefCell<Deque<u8, 64>>> = Mutex::new(RefCell::new(Deque::new()));
/// The buffer holds the largest number of frames that can be due together: a hello, a fault and two states.
static TO_SEND: Mutex<RefCell<Deque<u8, 160>>> = Mutex::new(RefCell::new(Deque::new()));
/// Number of bytes that an overrun or a wrong stop bit destroyed.
static LOST: Mutex<Cell<u16>> = Mutex::new(Cell::new(0));

/// The line.
pub struct Serial;

/// Enables the receiver, its interrupt, and 8N1 at the configured baud rate.
/// Call this with interrupts disabled.
pub fn start() {
    // Safety: only this module uses USART0.
    let usart = unsafe { Peripherals::steal() }.USART0;
    usart.ucsr0b.write(|w| unsafe { w.bits(0) });
    usart.ucsr0a.write(|w| w.u2x0().set_bit());
    // Frame format: 8 data bits, no parity, one stop bit.
    usart.ucsr0c.write(|w| unsafe { w.bits(0b0000_0110) });
    // This register must be written last, because the emulator then computes the baud rate.
    usart.ubrr0.write(|w| w.bits(UBRR));
    // RXCIE, RXEN, TXEN.
    usart.ucsr0b.write(|w| unsafe { w.bits(0b1001_1000) });
}

#[avr_device::interrupt(atmega328p)]
fn USART_RX() {
    // Safety: one register each.
    let usart = unsafe { Peripherals::steal() }.USART0;
    let status = usart.ucsr0a.read();
    let damaged = status.fe0().bit_is_set() || status.dor0().bit_is_set();
    let byte = usart.udr0.read().bits();
    interrupt::free(|cs| {
        let full = RECEIVED.borrow(cs).borrow_mut().push_back(byte).is_err();
        if full || damaged {
            let lost = LOST.borrow(cs);
            lost.set(lost.get().saturating_add(1));
        }
    });
}

#[avr_device::interrupt(atmega328p)]
fn USART_UDRE() {
    // Safety: one register each.
    let usart = unsafe { Peripherals::steal() }.USART0;
    interrupt::free(|cs| match TO_SEND.borrow(cs).borrow_mut().pop_front() {
        Some(byte) => {
            usart.udr0.write(|w| w.bits(byte));
        }
        None => {
            usart.ucsr0b.modify(|_, w| w.udrie0().clear_bit());
        }
    });
}

/// Number of bytes that [`Write`] accepts without waiting for the line.
pub fn room() -> usize {
    interrupt::free(|cs| {
        let queue = TO_SEND.borrow(cs).borrow();
        queue.capacity() - queue.len()
    })
}

/// Number of received bytes lost since start, up to 65535.
pub fn lost() -> u16 {
    interrupt::free(|cs| LOST.borrow(cs).get())
}

impl ErrorType for Serial {
    type Error = Infallible;
}

impl ReadReady for Serial {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(interrupt::free(|cs| !RECEIVED.borrow(cs).borrow().is_empty()))
    }
}

impl Read for Serial {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        if buffer.is_empty() {
            return Ok(0);
        }
        loop {
            let mut count = 0;
            for place in &mut *buffer {
                match interrupt::free(|cs| RECEIVED.borrow(cs).borrow_mut().pop_front()) {
                    Some(byte) => *place = byte,
                    None => break,
                }
                count += 1;
            }
            if count > 0 {
                return Ok(count);
            }
        }
    }
}

impl WriteReady for Serial {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(room() > 0)
    }
}

impl Write for Serial {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        if bytes.is_empty() {
            return Ok(0);
        }
        loop {
            let mut count = 0;
            for &byte in bytes {
                if interrupt::free(|cs| TO_SEND.borrow(cs).borrow_mut().push_back(byte)).is_err() {
                    break;
                }
                count += 1;
            }
            if count > 0 {
                // Safety: this changes one bit, and the interrupt that clears the same bit is disabled.
                interrupt::free(|_| {
                    let usart = unsafe { Peripherals::steal() }.USART0;
                    usart.ucsr0b.modify(|_, w| w.udrie0().set_bit());
                });
                return Ok(count);
            }
        }
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        while interrupt::free(|cs| !TO_SEND.borrow(cs).borrow().is_empty()) {}
        Ok(())
    }
}
