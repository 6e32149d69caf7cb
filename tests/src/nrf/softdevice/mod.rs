//! Models Nordic's SoftDevice S140 7.x, with the calls that the image uses, and a connected laptop.
//!
//! S140 is below the image in flash. It owns the radio and the vector table at 0, and is called by SVC.
//! Here, the calls run outside the emulated core.
//! They read arguments from the image's memory, return results, and raise events.
//! The image fetches these events after interrupt 22 (SWI2).
//! [`rules`] records actions that S140 forbids, which make the test fail.
//! The model omits the radio itself (packets either arrive or not), privacy, LE Secure Connections and central roles.

use std::collections::{BTreeMap, VecDeque};

pub mod abi;
pub mod central;
mod gap;
mod gatts;
mod link;
pub mod rules;
#[cfg(test)]
mod small_images;
mod soc_calls;

use super::nvic::Nvic;
use super::soc::Soc;
use super::system::ClockPower;
use abi::{Answer, call, error, put, u8_at, u16_at, u32_at};
use central::{Central, Happening};
use gap::{AdvertisingSet, Beacon};
use gatts::Table;
use link::Connection;
use rules::{Config, Rules};
use soc_calls::{FlashJob, UsbEvents};

/// Start of the application with S140 7.x; the MBR and S140 are below it.
pub const APPLICATION: u32 = 0x27000;

/// The state of the core at a call.
#[derive(Clone, Copy, Debug)]
pub struct Core {
    /// The registers r0 to r3.
    pub args: [u32; 4],
    /// The stack pointer of the caller.
    pub sp: u32,
    /// Whether interrupts are masked.
    pub masked: bool,
    /// First address after the statics of the image.
    pub statics_end: u32,
}

/// S140 and the laptop in its radio range.
#[derive(Default)]
pub struct SoftDevice {
    enabled_at: Option<u64>,
    application_ram: u32,
    ble: bool,
    config: Config,
    soc_events: Vec<u32>,
    events: VecDeque<Vec<u8>>,
    usb: UsbEvents,
    flash: Option<FlashJob>,
    /// Number of flash operations that will fail, as real operations do while the radio is busy.
    pub flash_refusals: u32,
    uuids: Vec<[u8; 16]>,
    table: Table,
    set: Option<AdvertisingSet>,
    beacon: Option<Beacon>,
    link: Option<Connection>,
    /// The laptop that is in radio range.
    pub central: Central,
    /// The rules that the image has violated.
    pub rules: Rules,
    /// Number of calls so far, by call number.
    pub calls: BTreeMap<u8, u64>,
    /// Number of cycles spent in S140's own interrupts.
    pub own_cycles: u64,
    /// Whether an interrupt handler in S140 ran. Such an interrupt wakes a sleeping core.
    pub woke: bool,
}

impl SoftDevice {
    /// Resets the chip: the radio falls silent, and the laptop notices this later.
    pub fn reset(&mut self, now: u64) {
        let before = std::mem::take(self);
        self.central = before.central;
        self.rules = before.rules;
        self.calls = before.calls;
        self.own_cycles = before.own_cycles;
        if let Some(link) = before.link {
            self.central.silence(now + link.supervision_cycles());
        }
    }

    /// Returns whether `sd_softdevice_enable` has succeeded.
    pub fn is_enabled(&self) -> bool {
        self.enabled_at.is_some()
    }

    /// Returns whether the board advertises.
    pub fn is_advertising(&self) -> bool {
        self.beacon.is_some()
    }

    /// Returns the RAM that the configuration needs (the model's estimate) and the RAM that the image leaves, in bytes.
    pub fn ram(&self) -> (u32, u32) {
        (self.config.ram_bytes(), self.application_ram.saturating_sub(super::memory::RAM_START))
    }

    /// Executes a call by SVC, and returns the resulting r0.
    pub fn call(&mut self, number: u8, core: Core, soc: &mut Soc) -> u32 {
        *self.calls.entry(number).or_default() += 1;
        self.check_core(number, core, soc);
        let answer = if number == call::SOFTDEVICE_ENABLE {
            self.enable(core.args, soc)
        } else if !self.is_enabled() {
            Err(error::NOT_ENABLED)
        } else {
            match number {
                32..=81 => self.soc_call(number, core.args, soc),
                call::BLE_CFG_SET => self.cfg_set(core.args, soc),
                call::BLE_ENABLE => self.ble_enable(core.args, soc),
                _ if !self.ble => Err(error::BLE_NOT_ENABLED),
                call::BLE_EVT_GET => self.evt_get(core.args, soc),
                call::UUID_VS_ADD => self.uuid_add(core.args, soc),
                108..=154 => self.gap_call(number, core.args, soc),
                168..=183 => self.gatts_call(number, core.args, soc),
                _ => self.unknown(number),
            }
        };
        answer.err().unwrap_or(0)
    }

    fn unknown(&mut self, number: u8) -> Answer {
        self.rules.broke(format!("call {number} is not modelled"));
        Err(error::NOT_SUPPORTED)
    }

    fn check_core(&mut self, number: u8, core: Core, soc: &mut Soc) {
        let calls_at = i32::from(rules::CALL_PRIORITY) << 5;
        if core.masked || soc.nvic.running() <= calls_at {
            // The core escalates an SVC in this state to a hard fault.
            self.rules.broke(format!("call {number} with interrupts masked or from priority 4 or above"));
        }
        let lowest = core.sp.saturating_sub(rules::STACK_BYTES);
        if lowest < core.statics_end {
            self.rules.broke(format!("call {number} finds no room on the stack"));
        } else {
            // S140 uses the caller's stack.
            soc.ram.put(lowest, &[0x5D; rules::STACK_BYTES as usize]);
        }
    }

    fn enable(&mut self, [clock, handler, ..]: [u32; 4], soc: &mut Soc) -> Answer {
        if self.is_enabled() {
            return Err(error::INVALID_STATE);
        }
        if handler & 1 == 0 {
            return Err(error::INVALID_ADDR);
        }
        if !rules::interrupts_fit(&soc.nvic) {
            return Err(error::INTERRUPT_CONFIGURATION);
        }
        let source = if clock == 0 { 0 } else { u32::from(u8_at(soc, clock)?) };
        let running = soc.power.read(0x418);
        if running & 1 << 16 != 0 && running & 3 != source {
            self.rules.broke("S140 has to restart the 32 kHz clock: its source differs from the running one");
        }
        soc.nvic.write(0xD1F, u32::from(rules::CALL_PRIORITY) << 5, 1);
        soc.nvic.write(0x400 + rules::EVENT_IRQ as u32, u32::from(rules::EVENT_PRIORITY) << 5, 1);
        self.enabled_at = Some(soc.now);
        Ok(())
    }

    fn cfg_set(&mut self, [id, config, ram, _]: [u32; 4], soc: &Soc) -> Answer {
        if self.ble {
            return Err(error::INVALID_STATE);
        }
        let c = &mut self.config;
        match id {
            // A connection configuration begins with a tag.
            32..=36 => {
                let tag = u8_at(soc, config)?;
                if tag == 0 || c.tag.is_some_and(|t| t != tag) {
                    return Err(error::INVALID_PARAM);
                }
                c.tag = Some(tag);
                match id {
                    32 => {
                        c.links = u8_at(soc, config + 2)?.into();
                        c.event_length = u16_at(soc, config + 4)?;
                        if c.event_length < 2 {
                            return Err(error::INVALID_PARAM);
                        }
                    }
                    34 => c.notifications = u8_at(soc, config + 2)?.into(),
                    35 => {
                        c.mtu = u16_at(soc, config + 2)?;
                        if c.mtu < 23 {
                            return Err(error::INVALID_PARAM);
                        }
                    }
                    _ => {}
                }
            }
            1 => c.uuids = u8_at(soc, config)?.into(),
            64 => {
                if u8_at(soc, config)? > 1 {
                    return Err(error::RESOURCES);
                }
                c.peripherals = u8_at(soc, config + 1)?;
            }
            65 => {
                let (len, max) = (u16_at(soc, config + 8)?, u16_at(soc, config + 10)?);
                if len > max || max > 248 {
                    return Err(error::INVALID_LENGTH);
                }
                c.name = abi::bytes(soc, u32_at(soc, config + 4)?, len.into())?;
            }
            66 | 67 | 160 => {}
            161 => c.table = u32_at(soc, config)?,
            _ => return Err(error::INVALID_PARAM),
        }
        if c.ram_bytes() > ram.saturating_sub(super::memory::RAM_START) { Err(error::NO_MEM) } else { Ok(()) }
    }

    fn ble_enable(&mut self, [base, ..]: [u32; 4], soc: &mut Soc) -> Answer {
        if self.ble {
            return Err(error::INVALID_STATE);
        }
        self.application_ram = u32_at(soc, base)?;
        let wanted = super::memory::RAM_START + self.config.ram_bytes().next_multiple_of(8);
        put(soc, base, &wanted.to_le_bytes())?;
        if wanted > self.application_ram {
            self.rules.broke(format!("S140 needs RAM up to {wanted:#x}, the image's begins below"));
            return Err(error::NO_MEM);
        }
        // From now on, the first part of RAM belongs to S140.
        soc.ram.put(super::memory::RAM_START, &vec![0x5D; (wanted - super::memory::RAM_START) as usize]);
        self.table = Table::new(self.config.table);
        self.ble = true;
        Ok(())
    }

    fn evt_get(&mut self, [place, len, ..]: [u32; 4], soc: &mut Soc) -> Answer {
        let event = self.events.front().ok_or(error::NOT_FOUND)?;
        let room = u16_at(soc, len)?;
        let size = (event.len() as u16).to_le_bytes();
        if place == 0 {
            return put(soc, len, &size);
        }
        if place & 3 != 0 {
            return Err(error::INVALID_ADDR);
        }
        if event.len() > room.into() {
            put(soc, len, &size)?;
            return Err(error::DATA_SIZE);
        }
        put(soc, place, event)?;
        put(soc, len, &size)?;
        self.events.pop_front();
        Ok(())
    }

    fn uuid_add(&mut self, [base, kind, ..]: [u32; 4], soc: &mut Soc) -> Answer {
        let mut uuid: [u8; 16] =
            abi::bytes(soc, base, 16)?.try_into().map_err(|_: Vec<u8>| error::INVALID_ADDR)?;
        // These two bytes contain the short form of the UUID.
        uuid[12..14].fill(0);
        let index = match self.uuids.iter().position(|u| *u == uuid) {
            Some(index) => index,
            None if self.uuids.len() == self.config.uuids => return Err(error::NO_MEM),
            None => {
                self.uuids.push(uuid);
                self.uuids.len() - 1
            }
        };
        put(soc, kind, &[index as u8 + 2])
    }

    /// Returns the full UUID for a short one with its type.
    fn whole_uuid(&self, short: u16, kind: u8) -> Option<[u8; 16]> {
        let mut uuid = *self.uuids.get(usize::from(kind).checked_sub(2)?)?;
        uuid[12..14].copy_from_slice(&short.to_le_bytes());
        Some(uuid)
    }

    fn raise(&mut self, event: Vec<u8>, nvic: &mut Nvic) {
        self.events.push_back(event);
        nvic.pend(rules::EVENT_IRQ);
    }

    fn raise_soc(&mut self, event: u32, nvic: &mut Nvic) {
        self.soc_events.push(event);
        nvic.pend(rules::EVENT_IRQ);
    }

    /// Accounts for the time of the core in S140's own interrupts.
    fn spend(&mut self, cycles: u64, soc: &mut Soc) {
        soc.now += cycles;
        soc.awake += cycles;
        self.own_cycles += cycles;
        self.woke = true;
    }

    /// Performs all actions that are due.
    pub fn advance(&mut self, now: u64, soc: &mut Soc) {
        if !self.is_enabled() {
            return;
        }
        self.advance_soc(now, soc);
        self.advance_beacon(now, soc);
        self.advance_link(now, soc);
        self.central.advance(now);
    }

    /// Returns the cycle of the next action.
    pub fn due(&self, power: &ClockPower, now: u64) -> Option<u64> {
        if !self.is_enabled() {
            return None;
        }
        let beacon = self.beacon.as_ref().map(|b| b.next);
        let link = self.link.as_ref().map(|l| l.next_event);
        [beacon, link, self.soc_due(power, now), self.central.due()].into_iter().flatten().min()
    }

    /// Ends the link for both sides.
    fn end_link(&mut self, reason: u8, told: Happening, soc: &mut Soc) {
        self.link = None;
        let event = abi::SocEvent::gap(abi::event::DISCONNECTED, link::HANDLE).with(&[reason]).finish();
        self.raise(event, &mut soc.nvic);
        self.central.tell(soc.now, told);
        self.central.left();
    }
}
