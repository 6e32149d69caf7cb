//! Calls that replace direct use of the chip's peripherals: flash, random numbers, power, clock, USB power.

use super::super::flash::PAGE;
use super::super::soc::Soc;
use super::super::system::ClockPower;
use super::super::time::{ms, us};
use super::abi::{Answer, bytes, call, error, put, soc_event};
use super::{APPLICATION, SoftDevice};
use crate::nrf::memory::FLASH_BYTES;

/// Time from a flash call until the radio leaves enough time for it.
const FLASH_WAIT: u64 = ms(3);
/// Overhead of S140 before and after the operation, which is at most 500 us according to its specification.
const FLASH_OVERHEAD: u64 = us(450);
/// Time for adding one byte to S140's pool of random numbers.
const RANDOM_BYTE: u64 = us(130);

const USB_DETECTED: u32 = 7;
const USB_REMOVED: u32 = 8;
const USB_READY: u32 = 9;

#[derive(Clone, Copy, Debug)]
enum What {
    Erase { page: u32 },
    Write { to: u32, from: u32, words: u32 },
}

/// A flash operation that is in progress.
#[derive(Clone, Copy, Debug)]
pub(super) struct FlashJob {
    what: What,
    at: u64,
    /// The result of the completed (or refused) operation, whose event comes at `at`.
    result: Option<u32>,
}

/// The events of USB power that the application has enabled.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct UsbEvents {
    detected: bool,
    removed: bool,
    ready: bool,
}

impl UsbEvents {
    fn wanted(&self) -> [(bool, u32, u32); 3] {
        [
            (self.detected, USB_DETECTED, soc_event::USB_DETECTED),
            (self.removed, USB_REMOVED, soc_event::USB_REMOVED),
            (self.ready, USB_READY, soc_event::USB_POWER_READY),
        ]
    }
}

impl SoftDevice {
    pub(super) fn soc_call(&mut self, number: u8, args: [u32; 4], soc: &mut Soc) -> Answer {
        let [a, b, c, _] = args;
        match number {
            call::EVT_GET => {
                // The event with the lowest number is reported first, regardless of the order in which events occurred.
                let event = self.soc_events.iter().copied().min().ok_or(error::NOT_FOUND)?;
                self.soc_events.retain(|&other| other != event);
                put(soc, a, &event.to_le_bytes())
            }
            call::RAND_VECTOR_GET => self.random(a, b as usize & 0xFF, soc),
            call::POWER_GPREGRET_SET | call::POWER_GPREGRET_CLR => {
                let register = if a == 0 { 0x51C } else { 0x520 };
                let now = soc.power.read(register);
                let value = if number == call::POWER_GPREGRET_SET { now | b } else { now & !b };
                soc.power.write(register, value, soc.now);
                Ok(())
            }
            call::HFCLK_REQUEST => {
                soc.power.write(0x000, 1, soc.now);
                Ok(())
            }
            call::HFCLK_RELEASE => {
                soc.power.write(0x004, 1, soc.now);
                Ok(())
            }
            call::USBDETECTED_ENABLE => {
                self.usb.detected = a != 0;
                Ok(())
            }
            call::USBREMOVED_ENABLE => {
                self.usb.removed = a != 0;
                Ok(())
            }
            call::USBPWRRDY_ENABLE => {
                self.usb.ready = a != 0;
                Ok(())
            }
            call::USBREGSTATUS_GET => {
                let status = soc.power.read(0x438);
                put(soc, a, &status.to_le_bytes())
            }
            call::FLASH_PAGE_ERASE => {
                if a >= (FLASH_BYTES / PAGE) as u32 {
                    return Err(error::INVALID_ADDR);
                }
                self.start_flash(a * PAGE as u32, What::Erase { page: a }, soc.now)
            }
            call::FLASH_WRITE => {
                if a & 3 != 0 || b & 3 != 0 || a as usize >= FLASH_BYTES {
                    return Err(error::INVALID_ADDR);
                }
                if c == 0 || c as usize > PAGE / 4 {
                    return Err(error::INVALID_LENGTH);
                }
                self.start_flash(a, What::Write { to: a, from: b, words: c }, soc.now)
            }
            _ => self.unknown(number),
        }
    }

    fn random(&mut self, place: u32, len: usize, soc: &mut Soc) -> Answer {
        let since = soc.now - self.enabled_at.unwrap_or(soc.now);
        if since < len as u64 * RANDOM_BYTE {
            return Err(error::RAND_NOT_ENOUGH);
        }
        let mut state = soc.now ^ 0x9E37_79B9_7F4A_7C15;
        let bytes: Vec<u8> = (0..len)
            .map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 56) as u8
            })
            .collect();
        put(soc, place, &bytes)
    }

    fn start_flash(&mut self, address: u32, what: What, now: u64) -> Answer {
        if address < APPLICATION {
            return Err(error::FORBIDDEN);
        }
        if self.flash.is_some() {
            return Err(error::BUSY);
        }
        self.flash = Some(FlashJob { what, at: now + FLASH_WAIT, result: None });
        Ok(())
    }

    fn work_flash(&mut self, mut job: FlashJob, soc: &mut Soc) -> Option<FlashJob> {
        if let Some(result) = job.result {
            self.raise_soc(result, &mut soc.nvic);
            return None;
        }
        if self.flash_refusals > 0 {
            self.flash_refusals -= 1;
            job.result = Some(soc_event::FLASH_ERROR);
            job.at += ms(200);
            return Some(job);
        }
        let now = soc.now;
        match job.what {
            What::Erase { page } => soc.nvmc.erase(&mut soc.flash, page as usize * PAGE, now),
            What::Write { to, from, words } => {
                // The data is read at this moment, and not at the time of the call.
                let data = bytes(soc, from, words as usize * 4).unwrap_or_default();
                for (i, word) in data.chunks_exact(4).enumerate() {
                    let word = u32::from_le_bytes([word[0], word[1], word[2], word[3]]);
                    soc.nvmc.program(&mut soc.flash, to as usize + 4 * i, word, now);
                }
            }
        }
        self.spend(FLASH_OVERHEAD, soc);
        job.result = Some(soc_event::FLASH_SUCCESS);
        job.at = soc.nvmc.busy_until.max(soc.now);
        Some(job)
    }

    pub(super) fn advance_soc(&mut self, now: u64, soc: &mut Soc) {
        while let Some(job) = self.flash.filter(|job| job.at <= now) {
            self.flash = self.work_flash(job, soc);
        }
        for (wanted, flag, event) in self.usb.wanted() {
            if wanted && soc.power.events.stands(flag) {
                soc.power.events.write(0x100 + 4 * flag, 0);
                self.raise_soc(event, &mut soc.nvic);
                self.woke = true;
            }
        }
    }

    pub(super) fn soc_due(&self, power: &ClockPower, now: u64) -> Option<u64> {
        let usb = self.usb.wanted().iter().any(|&(wanted, flag, _)| wanted && power.events.stands(flag));
        if usb { Some(now) } else { self.flash.map(|job| job.at) }
    }

    /// Blocks the core and the radio during a flash operation.
    pub(super) fn flash_holds(&self, at: u64, soc: &Soc) -> bool {
        soc.nvmc.busy_until > at
    }
}
