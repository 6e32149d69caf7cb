//! Emulates Nordic's SoftDevice Controller and MPSL for the image that contains its own host stack.
//!
//! The linked image contains both libraries. The emulator finds their functions by their symbols.
//! The emulator answers the calls itself and does not execute the libraries' code.
//! HCI packets go to a controller of bumble in another process (`air.rs`).
//! Everything above HCI is the code that users flash.
//! Nordic's own code runs only in `sdc_init`, `sdc_cfg_set` and `sdc_support_*`.
//! These functions only compute the required memory.
//! An image that provides too little memory therefore does not start here, either.
//!
//! Some parts are our own models and prove nothing about Nordic's code.
//! These parts are time slots, clocks, `sdc_enable`, `sdc_rand_*`, and the timing of the link (`link.rs`).
//! Bumble's controller lacks data length, PHY, RSSI, resolving list and buffers.
//! We therefore model these as well.

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

/// Cycles that a call into the libraries takes. This is a guess, because their code does not run here.
pub(super) const CALL_CYCLES: u64 = 300;

const CLOCK_POWER: usize = 0;
const RADIO: usize = 1;
const TIMER0: usize = 8;
const RTC0: usize = 11;

/// Error codes of the libraries.
const EAGAIN: i32 = -35;
const EPERM: i32 = -1;
const ENOMEM: i32 = -12;

/// A type of configuration (`SDC_CFG_TYPE_BUFFER_CFG`).
const BUFFERS: u32 = 3;
/// HCI constants: kinds of packets, kinds of events, and a status.
const DATA: u8 = 2;
const EVENT: u8 = 4;
const COMMAND_COMPLETE: u8 = 0x0E;
const COMMAND_STATUS: u8 = 0x0F;
const DISCONNECTED: u8 = 0x05;
const COMPLETED_PACKETS: u8 = 0x13;
const LE_META: u8 = 0x3E;
const UNKNOWN_COMMAND: u8 = 0x01;

/// What the emulator does after a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Then {
    /// The call returns this value.
    Return { value: u32, to: u32 },
    /// The library calls this function back.
    /// The callback returns to the address of the library's function.
    /// This return looks like another call of the function.
    CallBack { function: u32, arguments: [u32; 2] },
    /// Nordic's own code runs.
    Run,
}

/// A call from the image that waits until a callback returns.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    address: u32,
    to: u32,
    /// Whether the callback starts a time slot.
    starts_slot: bool,
}

/// Both libraries and the radio that they use.
pub struct Controller {
    air: Arc<Mutex<Air>>,
    index: u8,
    /// Names of the functions that the emulator answers, by address.
    functions: BTreeMap<u32, String>,
    low_priority: Option<usize>,
    told: u32,
    /// Sizes of the packet buffers in bytes, and their numbers.
    /// In each pair, the board's sending side comes first.
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
    /// Whether the laptop's radio is in range.
    pub in_range: bool,
    /// Number of bytes that reached the board over the air, and number of bytes that left it.
    pub passed: [u64; 2],
    /// Number of connection events, and number of those that the board missed.
    /// The board misses an event if the laptop is out of range or while it writes to flash.
    pub events: [u64; 2],
    /// Number of calls so far, by name of the function.
    pub calls: BTreeMap<String, u64>,
    /// The image's violations of the libraries' rules.
    pub broken: Vec<String>,
}

impl Controller {
    /// Creates the libraries of one board, whose number is 0 or 1.
    /// The libraries' functions are at these symbols, and `air` is the process that simulates the radio.
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

    /// Returns the addresses of the functions that the emulator answers.
    pub(super) fn addresses(&self) -> impl Iterator<Item = u32> {
        self.functions.keys().copied()
    }

    /// Returns the process that simulates the radio.
    ///
    /// # Panics
    /// Never panics in practice, because no other thread uses the lock.
    pub fn air(&self) -> std::sync::MutexGuard<'_, Air> {
        self.air.lock().expect("nobody panicked with it")
    }

    /// Returns whether there is a connection.
    pub fn is_connected(&self) -> bool {
        self.link.is_some()
    }

    /// Returns the connection's interval in cycles.
    pub fn interval(&self) -> Option<u64> {
        self.link.as_ref().map(|link| link.interval)
    }

    /// Returns the connection's supervision timeout in cycles.
    pub fn supervision(&self) -> Option<u64> {
        self.link.as_ref().map(|link| link.supervision)
    }

    /// Returns the number of bytes per radio packet, and whether the radio transmits at 2 Mbit/s.
    pub fn radio(&self) -> Option<(u16, bool)> {
        self.link.as_ref().map(|link| (link.octets, link.fast))
    }

    /// Returns the board's number on its air.
    pub fn number(&self) -> u8 {
        self.index
    }

    /// Sends a fragment of an L2CAP packet to the board. Unlike bumble, some laptops could send any fragment.
    pub fn inject(&mut self, fragment: &[u8], starts: bool) {
        let Some(link) = &mut self.link else { return };
        let head = link.handle | if starts { 2 << 12 } else { 1 << 12 };
        let mut packet = vec![DATA];
        packet.extend(head.to_le_bytes());
        packet.extend((fragment.len() as u16).to_le_bytes());
        packet.extend(fragment);
        link.down.push_back(packet);
    }

    /// Returns the number of packets to the board that wait for a connection event.
    pub fn waiting_down(&self) -> usize {
        self.link.as_ref().map_or(0, |link| link.down.len())
    }

    /// Simulates a reset of the chip. The radio falls silent, and the laptop notices this later.
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

    /// Tells the laptop to perform an action.
    /// Returns the number under which [`Air::log`] will contain the outcome.
    pub fn order(&mut self, mut order: serde_json::Value, soc: &mut Soc) -> u64 {
        order["board"] = self.index.into();
        let number = self.air().order(soc.now, order);
        self.take_in(soc);
        number
    }

    /// Executes a call of a function that the emulator answers.
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
                    // The timer runs at 1 MHz and starts together with the slot.
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

    /// Returns the next callback of the low-priority process. If there is none, the call ends.
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

    /// Sends an HCI packet from the board to bumble, and receives the resulting packets.
    fn send(&mut self, packet: &[u8], soc: &mut Soc) {
        self.air().ask(Ask::Packets, self.index, soc.now, packet);
        self.take_in(soc);
    }

    /// Receives the packets that bumble has for the board.
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
            // The connection is established.
            // In this event, interval, latency and time-out follow the addresses.
            [EVENT, LE_META, _, 1, 0, ..] => {
                self.link = Some(Link::new(half(5), [half(15), half(17), half(19)], now));
                self.to_host.push_back(packet);
            }
            [EVENT, DISCONNECTED, ..] => {
                if let Some(link) = self.link.take() {
                    // Some packets were already on their way.
                    // The board hears these packets before it hears of the disconnection.
                    self.to_host.extend(link.down);
                }
                self.sent = 0;
                self.to_host.push_back(packet);
            }
            [DATA, ..] => {
                let data = &packet[5..];
                let Some(link) = &mut self.link else { return };
                // The data arrives in pieces that fit into radio packets.
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

    /// Returns the cycle of the next action.
    pub fn due(&self, soc: &Soc) -> Option<u64> {
        let link = self.link.as_ref().map(|link| link.next_event.min(link.lost_at()));
        let air = Some(self.air().due).filter(|&due| due < u64::MAX);
        let clock = self.clock_wanted.filter(|_| soc.power.crystal).map(|_| soc.now);
        // Another board's packets have made bumble say something to this one.
        let inbox = (!self.air().inbox[usize::from(self.index)].is_empty()).then_some(soc.now);
        [link, air, clock, self.slot.due(), inbox].into_iter().flatten().min()
    }

    /// Performs all actions that are due by this time.
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
                // The new parameters apply from now on.
                // The same event also reports parameters that the central has chosen.
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

/// Returns bytes of the image's memory.
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
