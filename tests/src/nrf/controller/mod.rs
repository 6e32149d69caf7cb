//! Nordic's SoftDevice Controller and MPSL as the image with its own host calls them, answered at their C functions.
//!
//! The linked image holds both libraries. The functions of their interface are not executed here but answered from outside, by
//! their symbols. HCI goes to a controller of bumble in another process (`air.rs`); whatever is above HCI is the code that
//! users flash. `sdc_init`, `sdc_cfg_set` and `sdc_support_*`, which only count what memory is wanted, are Nordic's own, so
//! that an image that gives too little does not start here, either.
//!
//! Ours, and no proof of anything: time slots, clocks, `sdc_enable`, `sdc_rand_*`, what bumble's controller lacks (data
//! length, PHY, RSSI, resolving list, buffers), and the time of the link (`link.rs`).

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex};

mod air;
mod answers;
mod commands;
mod link;
mod mpsl;
mod slots;

use super::memory::FLASH_BYTES;
use super::nvic::Nvic;
use super::soc::Soc;
pub use air::Air;
use air::Ask;
use link::{Link, SHORT};
use slots::Slot;

/// Cycles of a call into the libraries; a guess, since nothing of them runs here.
pub(super) const CALL_CYCLES: u64 = 300;

const CLOCK_POWER: usize = 0;
const RADIO: usize = 1;
const TIMER0: usize = 8;
const RTC0: usize = 11;

/// Errors of the libraries.
const EAGAIN: i32 = -35;
const EPERM: i32 = -1;
const ENOMEM: i32 = -12;

/// A kind of configuration (`SDC_CFG_TYPE_BUFFER_CFG`).
const BUFFERS: u32 = 3;
/// HCI: packets' kinds, events, and a status.
const DATA: u8 = 2;
const EVENT: u8 = 4;
const COMMAND_COMPLETE: u8 = 0x0E;
const COMMAND_STATUS: u8 = 0x0F;
const DISCONNECTED: u8 = 0x05;
const COMPLETED_PACKETS: u8 = 0x13;
const LE_META: u8 = 0x3E;
const UNKNOWN_COMMAND: u8 = 0x01;

/// What happens after a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Then {
    /// It returns this.
    Return { value: u32, to: u32 },
    /// The library calls back; what the callback returns is the next call at the same address.
    CallBack { function: u32, arguments: [u32; 2] },
    /// Nordic's own code runs.
    Run,
}

/// A call of a function from outside that waits for a callback to return.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    address: u32,
    to: u32,
    /// The callback is the start of a time slot.
    starts_slot: bool,
}

/// Both libraries and their radio.
pub struct Controller {
    air: Arc<Mutex<Air>>,
    index: u8,
    /// Names of the answered functions by address.
    functions: BTreeMap<u32, String>,
    low_priority: Option<usize>,
    told: u32,
    /// Bytes and numbers of packets: sent by the board, received by it.
    buffers: ([u16; 2], [u8; 2]),
    to_host: VecDeque<Vec<u8>>,
    sent: usize,
    link: Option<Link>,
    slot: Slot,
    session: Option<u32>,
    clock_wanted: Option<u32>,
    low: VecDeque<(u32, [u32; 2])>,
    waiting: Vec<Waiting>,
    answer: Option<Vec<u8>>,
    /// Whether the laptop's radio is in reach.
    pub in_range: bool,
    /// Bytes of the packets that reached the board over the air, and that left it.
    pub passed: [u64; 2],
    /// Events of connections, and those of them that the board missed for want of range or for flash.
    pub events: [u64; 2],
    /// Calls so far, by name.
    pub calls: BTreeMap<String, u64>,
    /// What the image did against the libraries' rules.
    pub broken: Vec<String>,
}

impl Controller {
    /// Libraries whose functions lie at these symbols, on this air, as its board of this number (0 or 1).
    pub fn new(symbols: &BTreeMap<String, u32>, air: Arc<Mutex<Air>>, index: u8) -> Self {
        let answered =
            |name: &str| ["sdc_", "mpsl_", "MPSL_IRQ_"].iter().any(|start| name.starts_with(start));
        let functions = symbols
            .iter()
            .filter(|&(name, &address)| answered(name) && (address as usize) < FLASH_BYTES)
            .map(|(name, &address)| (address & !1, name.clone()))
            .collect();
        Self {
            air,
            index,
            functions,
            low_priority: None,
            told: 0,
            buffers: ([SHORT; 2], [3, 2]),
            to_host: VecDeque::new(),
            sent: 0,
            link: None,
            slot: Slot::None,
            session: None,
            clock_wanted: None,
            low: VecDeque::new(),
            waiting: Vec::new(),
            answer: None,
            in_range: true,
            passed: [0; 2],
            events: [0; 2],
            calls: BTreeMap::new(),
            broken: Vec::new(),
        }
    }

    /// Where the answered functions lie.
    pub(super) fn addresses(&self) -> impl Iterator<Item = u32> {
        self.functions.keys().copied()
    }

    /// The air.
    ///
    /// # Panics
    /// Never: no other thread has it.
    pub fn air(&self) -> std::sync::MutexGuard<'_, Air> {
        self.air.lock().expect("nobody panicked with it")
    }

    /// Whether there is a connection.
    pub fn is_connected(&self) -> bool {
        self.link.is_some()
    }

    /// The connection's interval in cycles.
    pub fn interval(&self) -> Option<u64> {
        self.link.as_ref().map(|link| link.interval)
    }

    /// Octets per radio packet and whether the radio is at 2 Mbit/s.
    pub fn radio(&self) -> Option<(u16, bool)> {
        self.link.as_ref().map(|link| (link.octets, link.fast))
    }

    /// The board's number on its air.
    pub fn number(&self) -> u8 {
        self.index
    }

    /// Puts an L2CAP packet on the air to the board, as a laptop that is not bumble could.
    pub fn inject(&mut self, fragment: &[u8], starts: bool) {
        let Some(link) = &mut self.link else { return };
        let head = link.handle | if starts { 2 << 12 } else { 1 << 12 };
        let mut packet = vec![DATA];
        packet.extend(head.to_le_bytes());
        packet.extend((fragment.len() as u16).to_le_bytes());
        packet.extend(fragment);
        link.down.push_back(packet);
    }

    /// Packets that still wait for their event.
    pub fn waiting_down(&self) -> usize {
        self.link.as_ref().map_or(0, |link| link.down.len())
    }

    /// After a reset of the chip: the radio falls silent, the laptop notices later.
    pub fn reset(&mut self, now: u64) {
        let mut fresh = Self::new(&BTreeMap::new(), self.air.clone(), self.index);
        std::mem::swap(&mut fresh.functions, &mut self.functions);
        fresh.calls = std::mem::take(&mut self.calls);
        fresh.broken = std::mem::take(&mut self.broken);
        fresh.in_range = self.in_range;
        (fresh.passed, fresh.events) = (self.passed, self.events);
        let silence = self.link.as_ref().map_or(0, |link| link.supervision);
        *self = fresh;
        self.air().ask(Ask::Silent, self.index, now, &silence.to_le_bytes());
        self.air().inbox[usize::from(self.index)].clear();
    }

    /// Tells the laptop to do something; the number under which its outcome will stand in [`Air::log`].
    pub fn order(&mut self, mut order: serde_json::Value, soc: &mut Soc) -> u64 {
        order["board"] = self.index.into();
        let number = self.air().order(soc.now, order);
        self.take_in(soc);
        number
    }

    /// A call of an answered function.
    pub(super) fn call(&mut self, address: u32, lr: u32, args: [u32; 4], soc: &mut Soc) -> Then {
        let name = self.functions[&address].clone();
        let is_return = self.waiting.last().is_some_and(|w| w.address == address);
        if is_return {
            let waiting = self.waiting.pop().expect("seen above");
            if waiting.starts_slot {
                self.slot_returned(args[0], soc);
            }
            return self.next_call_back(address, waiting.to);
        }
        *self.calls.entry(name.clone()).or_default() += 1;
        match name.as_str() {
            "mpsl_low_priority_process" => {
                if !self.to_host.is_empty() && self.told & 1 == 1 {
                    self.low.push_back((self.told, [0; 2]));
                }
                return self.next_call_back(address, lr);
            }
            "MPSL_IRQ_TIMER0_Handler" => {
                if let (Slot::Pending { length }, Some(session)) = (self.slot, self.session) {
                    self.slot = Slot::Running { until: soc.now + length };
                    // A clock of 1 MHz that began with the slot.
                    for (offset, value) in [(0x504, 0), (0x508, 3), (0x510, 4), (0x00C, 1), (0x000, 1)] {
                        soc.write(0x4000_8000 + offset, value, 4);
                    }
                    self.waiting.push(Waiting { address, to: lr, starts_slot: true });
                    return Then::CallBack { function: session, arguments: [0, 0] };
                }
                return Then::Return { value: 0, to: lr };
            }
            _ => {}
        }
        if name == "sdc_cfg_set" && args[1] == BUFFERS {
            let half = |at: u32| u16::from_le_bytes(load(soc, args[2] + at));
            let [sent, received] = load(soc, args[2] + 4);
            self.buffers = ([half(0), half(2)], [sent, received]);
        }
        if ["sdc_init", "sdc_cfg_set"].contains(&name.as_str()) || name.starts_with("sdc_support_") {
            return Then::Run;
        }
        let value = match name.as_str() {
            _ if name.starts_with("sdc_hci_cmd_") => self.command(&name, args, soc),
            _ if name.starts_with("sdc_") => self.sdc(&name, args, soc) as u32,
            _ => self.mpsl(&name, args, soc) as u32,
        };
        Then::Return { value, to: lr }
    }

    /// The next callback from the low priority; else the end of the call.
    fn next_call_back(&mut self, address: u32, to: u32) -> Then {
        let is_low = self.functions[&address] == "mpsl_low_priority_process";
        match self.low.pop_front().filter(|_| is_low) {
            Some((function, arguments)) => {
                self.waiting.push(Waiting { address, to, starts_slot: false });
                Then::CallBack { function, arguments }
            }
            None => Then::Return { value: 0, to },
        }
    }

    fn pend_low(&self, nvic: &mut Nvic) {
        if let Some(irq) = self.low_priority {
            nvic.pend(irq);
        }
    }

    fn sdc(&mut self, name: &str, args: [u32; 4], soc: &mut Soc) -> i32 {
        match name {
            "sdc_enable" => {
                self.told = args[0];
                0
            }
            "sdc_disable" => {
                self.told = 0;
                0
            }
            "sdc_hci_data_put" => {
                let head: [u8; 4] = load(soc, args[0]);
                let len = usize::from(u16::from_le_bytes([head[2], head[3]]));
                let data = bytes(soc, args[0], 4 + len);
                let Some(link) = &mut self.link else { return 0 };
                if len > usize::from(self.buffers.0[0]) || self.sent >= usize::from(self.buffers.1[0]) {
                    self.broken.push(format!("a data packet of {len} bytes with {} on the way", self.sent));
                    return ENOMEM;
                }
                self.sent += 1;
                link.up.push_back([&[DATA], &data[..]].concat());
                0
            }
            "sdc_hci_get" => {
                let Some(packet) = self.to_host.pop_front() else { return EAGAIN };
                store(soc, args[1], &packet[..1]);
                store(soc, args[0], &packet[1..]);
                if !self.to_host.is_empty() {
                    self.pend_low(&mut soc.nvic);
                }
                0
            }
            "sdc_build_revision_get" => {
                store(soc, args[0], &[0; 20]);
                0
            }
            "sdc_rand_source_register" | "sdc_default_tx_power_set" => 0,
            _ => {
                self.broken.push(format!("`{name}` is not modelled"));
                EPERM
            }
        }
    }

    /// HCI packets of the board go to bumble, and what that brings comes in.
    fn send(&mut self, packet: &[u8], soc: &mut Soc) {
        self.air().ask(Ask::Packets, self.index, soc.now, packet);
        self.take_in(soc);
    }

    /// Takes in what bumble has for the board.
    fn take_in(&mut self, soc: &mut Soc) {
        loop {
            let Some(packet) = self.air().inbox[usize::from(self.index)].pop_front() else { break };
            self.arrived(packet, soc.now);
        }
        if !self.to_host.is_empty() {
            self.pend_low(&mut soc.nvic);
        }
    }

    fn arrived(&mut self, packet: Vec<u8>, now: u64) {
        let half = |at: usize| u16::from_le_bytes([packet[at], packet[at + 1]]);
        match packet[..] {
            [EVENT, COMMAND_COMPLETE, ..] => self.answer = Some(packet[6..].to_vec()),
            [EVENT, COMMAND_STATUS, ..] => self.answer = Some(packet[3..4].to_vec()),
            [EVENT, COMPLETED_PACKETS, ..] => {
                self.sent = self.sent.saturating_sub(half(6).into());
                self.to_host.push_back(packet);
            }
            // The connection stands: interval, latency and timeout lie behind the addresses.
            [EVENT, LE_META, _, 1, 0, ..] => {
                self.link = Some(Link::new(half(5), [half(15), half(17), half(19)], now));
                self.to_host.push_back(packet);
            }
            [EVENT, DISCONNECTED, ..] => {
                if let Some(link) = self.link.take() {
                    // What was on its way before is heard before.
                    self.to_host.extend(link.down);
                }
                self.sent = 0;
                self.to_host.push_back(packet);
            }
            [DATA, ..] => {
                let data = &packet[5..];
                let Some(link) = &mut self.link else { return };
                // As the radio packets bring it.
                for (i, piece) in data.chunks(link.octets.into()).enumerate() {
                    let head = link.handle | if i == 0 { 2 << 12 } else { 1 << 12 };
                    let mut fragment = vec![DATA];
                    fragment.extend(head.to_le_bytes());
                    fragment.extend((piece.len() as u16).to_le_bytes());
                    fragment.extend(piece);
                    link.down.push_back(fragment);
                }
            }
            _ => match &mut self.link {
                Some(link) => link.down.push_back(packet),
                None => self.to_host.push_back(packet),
            },
        }
    }

    /// Cycle of the next thing to do.
    pub fn due(&self, soc: &Soc) -> Option<u64> {
        let link = self.link.as_ref().map(|link| link.next_event.min(link.lost_at()));
        let air = Some(self.air().due).filter(|&due| due < u64::MAX);
        let clock = self.clock_wanted.filter(|_| soc.power.crystal).map(|_| soc.now);
        // Another board's packets have made bumble say something to this one.
        let inbox = (!self.air().inbox[usize::from(self.index)].is_empty()).then_some(soc.now);
        [link, air, clock, self.slot.due(), inbox].into_iter().flatten().min()
    }

    /// Does what is due by now.
    pub fn advance(&mut self, now: u64, soc: &mut Soc) {
        let air_is_due = self.air().due <= now;
        if air_is_due {
            self.air().ask(Ask::Packets, self.index, now, &[]);
        }
        self.take_in(soc);
        if soc.power.crystal
            && let Some(call_back) = self.clock_wanted.take()
            && call_back != 0
        {
            self.low.push_back((call_back, [1, 0]));
            self.pend_low(&mut soc.nvic);
        }
        if self.slot.due().is_some_and(|due| due <= now) {
            match self.slot {
                Slot::Planned { length, .. } => {
                    self.slot = Slot::Pending { length };
                    soc.nvic.pend(TIMER0);
                }
                _ => {
                    self.slot = Slot::None;
                    if let Some(call_back) = self.session {
                        self.low.push_back((call_back, [0, 5]));
                        self.pend_low(&mut soc.nvic);
                    }
                }
            }
        }
        self.advance_link(now, soc);
    }

    fn advance_link(&mut self, now: u64, soc: &mut Soc) {
        while let Some(link) = &mut self.link {
            let at = link.next_event;
            if link.lost_at() <= now && link.lost_at() <= at {
                self.air().ask(Ask::Lost, self.index, now, &[]);
                self.take_in(soc);
                assert!(self.link.is_none(), "bumble ends a lost connection");
                return;
            }
            if at > now {
                return;
            }
            let is_missed = !self.in_range || self.slot.holds(at);
            let (up, down) = link.event(is_missed);
            self.events[0] += 1;
            self.events[1] += u64::from(is_missed);
            for packet in up {
                self.passed[1] += packet.len() as u64 - 5;
                self.send(&packet, soc);
            }
            for packet in down {
                if packet[0] == DATA {
                    self.passed[0] += packet.len() as u64 - 5;
                }
                // New parameters count from here on; an offer of the central is such an event, too.
                if let ([EVENT, LE_META, _, 3, 0, ..], Some(link)) = (&packet[..], &mut self.link) {
                    let half = |at: usize| u16::from_le_bytes([packet[at], packet[at + 1]]);
                    link.set([half(7), half(9), half(11)]);
                }
                self.to_host.push_back(packet);
            }
            if !self.to_host.is_empty() {
                self.pend_low(&mut soc.nvic);
            }
        }
    }
}

/// Bytes of the image's memory.
fn bytes(soc: &Soc, at: u32, len: usize) -> Vec<u8> {
    if len == 0 {
        return Vec::new();
    }
    match soc.ram.get(at, len) {
        Some(bytes) => bytes.to_vec(),
        None => soc.flash.get(at as usize..at as usize + len).map_or_else(|| vec![0; len], <[u8]>::to_vec),
    }
}

fn load<const N: usize>(soc: &Soc, at: u32) -> [u8; N] {
    bytes(soc, at, N).try_into().expect("as many as asked for")
}

fn store(soc: &mut Soc, at: u32, bytes: &[u8]) {
    assert!(soc.ram.put(at, bytes), "the image wants {} bytes at {at:#x}", bytes.len());
}
