//! UARTE: a serial port with EasyDMA. Bytes take their real time in both directions.

use std::collections::VecDeque;

use super::events::Events;
use super::memory::Ram;
use super::time::{HZ, ms};

const RXDRDY: u32 = 2;
const ENDRX: u32 = 4;
const TXDRDY: u32 = 7;
const ENDTX: u32 = 8;
const ERROR: u32 = 9;
const RXTO: u32 = 17;
const RXSTARTED: u32 = 19;
const TXSTARTED: u32 = 20;
const TXSTOPPED: u32 = 22;
const ENDRX_STARTRX: u32 = 1 << 5;
const ENDRX_STOPRX: u32 = 1 << 6;
/// Capacity of the receiver in bytes while EasyDMA does not run.
const FIFO: usize = 6;

/// One of UARTE0 and UARTE1.
#[derive(Clone, Debug, Default)]
pub struct Uarte {
    /// Events of this peripheral.
    pub events: Events,
    registers: [u32; 32],
    enable: u32,
    baud: u32,
    config: u32,
    error: u32,
    rx: [u32; 3],
    tx: [u32; 3],
    receiving: Option<(u32, u32)>,
    receiver_on: bool,
    fifo: VecDeque<u8>,
    arriving: VecDeque<(u64, u8)>,
    sending: Option<(Vec<u8>, u64, usize)>,
    sent: Vec<(u64, u8)>,
    /// Number of bytes lost because EasyDMA did not run.
    pub overruns: u64,
    /// Number of times that pins were selected while the port was on, which the chip forbids.
    pub pins_while_on: u32,
    /// Whether the receiving pin is floating, so that noise arrives.
    floating: bool,
    noise: u64,
}

impl Uarte {
    /// Keeps the data that is on the wire when the chip is reset.
    pub fn keep_line(&mut self, before: Self) {
        self.arriving = before.arriving;
        self.sent = before.sent;
        self.overruns = before.overruns;
        self.baud = before.baud;
        (self.floating, self.noise) = (before.floating, before.noise);
    }

    fn byte_cycles(&self) -> u64 {
        let baud = match self.baud {
            0x01D6_0000 => 115_200,
            0x1000_0000 => 1_000_000,
            0x0EBE_DFA4..=0x0EBF_0000 => 921_600,
            _ => 9_600,
        };
        10 * HZ / baud
    }

    /// Returns whether the receiver is on.
    pub fn is_receiving(&self) -> bool {
        self.enable == 8 && self.receiver_on
    }

    /// Sets whether the receiving pin is floating.
    pub fn set_floating(&mut self, floating: bool, now: u64) {
        if floating != self.floating {
            self.floating = floating;
            self.arriving.clear();
            self.pick_up_noise(now);
        }
    }

    fn pick_up_noise(&mut self, now: u64) {
        if self.floating {
            self.noise =
                self.noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            self.arriving.push_back((now + ms(1), (self.noise >> 56) as u8));
        }
    }

    /// Sends bytes to the board in sequence from now on.
    pub fn receive(&mut self, bytes: &[u8], now: u64) {
        let byte = self.byte_cycles();
        let mut at = self.arriving.back().map_or(now, |&(at, _)| at.max(now));
        for &b in bytes {
            at += byte;
            self.arriving.push_back((at, b));
        }
    }

    /// Returns the bytes that the board sent since the last call, each with the cycle of its end.
    pub fn take_sent(&mut self) -> Vec<(u64, u8)> {
        std::mem::take(&mut self.sent)
    }

    fn take_byte(&mut self, byte: u8, ram: &mut Ram) {
        if let Some((start, max)) = self.receiving {
            ram.put(start + self.rx[2], &[byte]);
            self.rx[2] += 1;
            self.events.fire(RXDRDY);
            if self.rx[2] == max {
                self.receiving = None;
                self.events.fire(ENDRX);
                if self.events.shorts & ENDRX_STARTRX != 0 {
                    self.start_rx();
                } else if self.events.shorts & ENDRX_STOPRX != 0 {
                    self.receiver_on = false;
                    self.events.fire(RXTO);
                }
            }
        } else if self.receiver_on && self.fifo.len() < FIFO {
            self.fifo.push_back(byte);
        } else {
            self.overruns += 1;
            if self.receiver_on {
                self.error |= 1;
                self.events.fire(ERROR);
            }
        }
    }

    fn start_rx(&mut self) {
        self.receiver_on = true;
        self.rx[2] = 0;
        // Pointer and length are latched here, so the image may already write the next pointer and length.
        self.receiving = Some((self.rx[0], self.rx[1]));
        self.events.fire(RXSTARTED);
    }

    /// Raises all events that are due.
    pub fn advance(&mut self, now: u64, ram: &mut Ram) {
        while self.receiving.is_some()
            && let Some(byte) = self.fifo.pop_front()
        {
            self.take_byte(byte, ram);
        }
        // Bytes are processed one at a time, because the PPI must handle each before the next (see `Soc::advance`).
        if let Some(&(at, byte)) = self.arriving.front()
            && at <= now
        {
            self.arriving.pop_front();
            self.take_byte(byte, ram);
            self.pick_up_noise(at);
        }
        let byte_cycles = self.byte_cycles();
        if let Some((bytes, started, done)) = &mut self.sending {
            while *done < bytes.len() && *started + (*done as u64 + 1) * byte_cycles <= now {
                self.sent.push((*started + (*done as u64 + 1) * byte_cycles, bytes[*done]));
                *done += 1;
            }
            if *done == bytes.len() {
                self.tx[2] = bytes.len() as u32;
                self.sending = None;
                self.events.fire(TXDRDY);
                self.events.fire(ENDTX);
            }
        }
    }

    /// Returns the cycle of the next event.
    pub fn due(&self) -> Option<u64> {
        let arrives = self.arriving.front().map(|&(at, _)| at);
        let sent = self.sending.as_ref().map(|(bytes, at, _)| at + bytes.len() as u64 * self.byte_cycles());
        arrives.into_iter().chain(sent).min()
    }

    /// Reads a register.
    pub fn read(&self, offset: u32) -> u32 {
        match offset {
            0x480 => self.error,
            0x500 => self.enable,
            0x508..=0x514 => self.registers[(offset as usize - 0x508) / 4],
            0x524 => self.baud,
            0x534..=0x53C => self.rx[(offset as usize - 0x534) / 4],
            0x544..=0x54C => self.tx[(offset as usize - 0x544) / 4],
            0x56C => self.config,
            _ => self.events.read(offset).unwrap_or(0),
        }
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32, now: u64, ram: &Ram) {
        let enabled = self.enable == 8;
        match offset {
            0x000 if value & 1 != 0 && enabled => self.start_rx(),
            0x004 if value & 1 != 0 => {
                self.receiver_on = false;
                if self.receiving.take().is_some() {
                    self.events.fire(ENDRX);
                }
                self.events.fire(RXTO);
            }
            0x008 if value & 1 != 0 && enabled => {
                // EasyDMA cannot read flash, so such a transfer would send garbage.
                let bytes = ram.get(self.tx[0], self.tx[1] as usize).map(<[u8]>::to_vec).unwrap_or_default();
                self.events.fire(TXSTARTED);
                self.sending = Some((bytes, now, 0));
            }
            0x00C if value & 1 != 0 => {
                self.sending = None;
                self.events.fire(TXSTOPPED);
            }
            0x480 => self.error &= !value,
            0x500 => self.enable = value & 0xF,
            0x508..=0x514 if enabled => self.pins_while_on += 1,
            0x508..=0x514 => self.registers[(offset as usize - 0x508) / 4] = value,
            0x524 => self.baud = value,
            0x534..=0x53C => self.rx[(offset as usize - 0x534) / 4] = value,
            0x544..=0x54C => self.tx[(offset as usize - 0x544) / 4] = value,
            0x56C => self.config = value,
            _ => {
                self.events.write(offset, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nrf::memory::RAM_START;

    fn port() -> (Uarte, Ram) {
        let mut uart = Uarte::default();
        let ram = Ram::default();
        uart.write(0x500, 8, 0, &ram);
        uart.write(0x524, 0x01D6_0000, 0, &ram);
        (uart, ram)
    }

    fn advance(uart: &mut Uarte, now: u64, ram: &mut Ram) {
        while uart.due().is_some_and(|d| d <= now) {
            uart.advance(now, ram);
        }
    }

    #[test]
    fn bytes_leave_one_after_the_other_at_the_baud_rate() {
        let (mut uart, mut ram) = port();
        ram.put(RAM_START, b"abc");
        uart.write(0x544, RAM_START, 0, &ram);
        uart.write(0x548, 3, 0, &ram);
        uart.write(0x008, 1, 1000, &ram);
        let byte = 10 * HZ / 115_200;
        assert_eq!(uart.due(), Some(1000 + 3 * byte));
        advance(&mut uart, 1000 + 3 * byte, &mut ram);
        assert!(uart.events.stands(ENDTX));
        let sent = uart.take_sent();
        assert_eq!(sent.iter().map(|s| s.1).collect::<Vec<_>>(), b"abc");
        assert_eq!(sent[0].0, 1000 + byte);
    }

    #[test]
    fn a_second_buffer_that_is_set_up_in_time_takes_over_without_a_loss() {
        let (mut uart, mut ram) = port();
        uart.write(0x200, ENDRX_STARTRX, 0, &ram);
        uart.write(0x534, RAM_START, 0, &ram);
        uart.write(0x538, 2, 0, &ram);
        uart.write(0x000, 1, 0, &ram);
        uart.write(0x534, RAM_START + 16, 0, &ram);
        uart.receive(b"wxyz", 0);
        advance(&mut uart, HZ, &mut ram);
        assert_eq!(ram.get(RAM_START, 2), Some(&b"wx"[..]));
        assert_eq!(ram.get(RAM_START + 16, 2), Some(&b"yz"[..]));
        assert_eq!(uart.overruns, 0);
    }

    #[test]
    fn bytes_beyond_the_receivers_fifo_are_lost_and_reported() {
        let (mut uart, mut ram) = port();
        uart.write(0x538, 1, 0, &ram);
        uart.write(0x534, RAM_START, 0, &ram);
        uart.write(0x000, 1, 0, &ram);
        uart.receive(b"123456789", 0);
        advance(&mut uart, HZ, &mut ram);
        assert_eq!(uart.overruns, 2);
        assert!(uart.events.stands(ERROR));
    }
}
