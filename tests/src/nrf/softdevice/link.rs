//! A connection with its connection events, the packets in them, and its end.

use std::collections::VecDeque;

use super::super::soc::Soc;
use super::super::time::{ms, us};
use super::abi::{self, SocEvent, event, reason, u16_at};
use super::central::{Command, Happening};
use super::gap::Pairing;
use super::{SoftDevice, rules};

/// Handle of the only connection.
pub(super) const HANDLE: u16 = 0;
/// Unit of the connection interval.
const UNIT: u64 = us(1250);
/// S140 raises a timeout if it gets no authenticated packet for this long. (Empty acknowledgements do not count.)
const PAYLOAD_TIMEOUT: u64 = ms(480_000);
/// Source of this timeout.
const AUTHENTICATED_PAYLOAD: u8 = 3;
/// Maximum number of write commands in one connection event.
const COMMANDS_PER_EVENT: usize = 4;

/// Connection parameters (`ble_gap_conn_params_t`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Parameters {
    min: u16,
    max: u16,
    latency: u16,
    supervision: u16,
}

impl Parameters {
    /// Reads the parameters and checks them in the same way as S140.
    pub(super) fn read(soc: &Soc, at: u32) -> Result<Self, u32> {
        let p = Self {
            min: u16_at(soc, at)?,
            max: u16_at(soc, at + 2)?,
            latency: u16_at(soc, at + 4)?,
            supervision: u16_at(soc, at + 6)?,
        };
        if p.are_valid() { Ok(p) } else { Err(abi::error::INVALID_PARAM) }
    }

    fn are_valid(&self) -> bool {
        // The supervision timeout must be longer than twice the longest silence.
        let silence = 2 * u64::from(self.latency + 1) * u64::from(self.max) * UNIT;
        6 <= self.min
            && self.min <= self.max
            && self.max <= 3200
            && self.latency <= 499
            && (10..=3200).contains(&self.supervision)
            && ms(10 * u64::from(self.supervision)) > silence
    }

    pub(super) fn as_halves(&self) -> [u16; 4] {
        [self.min, self.max, self.latency, self.supervision]
    }
}

/// The state of the connection.
#[derive(Clone, Debug)]
pub(super) struct Connection {
    pub(super) parameters: Parameters,
    pub(super) next_event: u64,
    heard_at: u64,
    /// Time at which the laptop's last packet with content arrived.
    content_at: u64,
    skipped: u16,
    pub(super) mtu: u16,
    pub(super) mtu_asked: Option<u16>,
    data_length: u16,
    pub(super) longer_in: Option<(u16, u8)>,
    fast: bool,
    pub(super) fast_in: Option<u8>,
    pub(super) encrypted: bool,
    pub(super) encrypted_in: Option<u8>,
    pub(super) key_asked: bool,
    pub(super) pairing_asked: Option<bool>,
    pub(super) pairing: Option<Pairing>,
    pub(super) system_attributes: bool,
    pub(super) attributes_asked: bool,
    pub(super) subscribed: bool,
    pub(super) queue: VecDeque<Vec<u8>>,
    /// The request of the board, and the number of connection events until the laptop answers it.
    pub(super) asked: Option<(Parameters, u8)>,
    /// The new parameters, and the number of connection events until they apply.
    pub(super) update: Option<(Parameters, u8)>,
    pub(super) closing: Option<u8>,
}

impl Connection {
    pub(super) fn new(at: u64, interval: u16) -> Self {
        let parameters = Parameters { min: interval, max: interval, latency: 0, supervision: 42 };
        Self {
            parameters,
            next_event: at + us(2500) + u64::from(interval) * UNIT,
            heard_at: at,
            content_at: at,
            skipped: 0,
            mtu: 23,
            mtu_asked: None,
            data_length: 27,
            longer_in: None,
            fast: false,
            fast_in: None,
            encrypted: false,
            encrypted_in: None,
            key_asked: false,
            pairing_asked: None,
            pairing: None,
            system_attributes: false,
            attributes_asked: false,
            subscribed: false,
            queue: VecDeque::new(),
            asked: None,
            update: None,
            closing: None,
        }
    }

    pub(super) fn interval_cycles(&self) -> u64 {
        u64::from(self.parameters.max) * UNIT
    }

    pub(super) fn supervision_cycles(&self) -> u64 {
        ms(10 * u64::from(self.parameters.supervision))
    }

    /// Returns the radio time of a notification including its acknowledgements.
    fn air_time(&self, len: usize) -> u64 {
        let mut rest = len + 7;
        let mut time = 0;
        let (byte, overhead) = if self.fast { (4, 11) } else { (8, 10) };
        while rest > 0 {
            let piece = rest.min(self.data_length.into());
            rest -= piece;
            let check = if self.encrypted { 4 } else { 0 };
            time += us(byte * (overhead + piece as u64 + check) + 150 + byte * overhead + 150);
        }
        time
    }

    fn procedures_run(&self) -> bool {
        self.pairing.is_some()
            || self.pairing_asked.is_some()
            || self.encrypted_in.is_some()
            || self.asked.is_some()
            || self.update.is_some()
            || self.closing.is_some()
            || self.longer_in.is_some()
            || self.fast_in.is_some()
            || self.mtu_asked.is_some()
    }
}

fn count_down<T: Copy>(waiting: &mut Option<(T, u8)>) -> Option<T> {
    let (value, left) = waiting.as_mut()?;
    if *left > 0 {
        *left -= 1;
        return None;
    }
    let value = *value;
    *waiting = None;
    Some(value)
}

fn tick(waiting: &mut Option<u8>) -> bool {
    match waiting {
        Some(0) => {
            *waiting = None;
            true
        }
        Some(left) => {
            *left -= 1;
            false
        }
        None => false,
    }
}

impl SoftDevice {
    /// Performs the connection events that are due.
    pub(super) fn advance_link(&mut self, now: u64, soc: &mut Soc) {
        while self.link.as_ref().is_some_and(|l| l.next_event <= now) {
            self.connection_event(soc);
        }
    }

    fn connection_event(&mut self, soc: &mut Soc) {
        let held = self.link.as_ref().is_some_and(|l| self.flash_holds(l.next_event, soc));
        let heard = self.central.in_range && !held;
        let link = self.link.as_mut().expect("a link");
        let at = link.next_event;
        link.next_event += link.interval_cycles();
        if !heard {
            if at - link.heard_at > link.supervision_cycles() {
                self.end_link(reason::TIMEOUT, Happening::Disconnected(reason::TIMEOUT), soc);
            } else if !held {
                // The board listened, but the laptop sent nothing.
                self.spend(rules::connection_event(0), soc);
            }
            return;
        }
        if link.skipped < link.parameters.latency && link.queue.is_empty() && !link.procedures_run() {
            link.skipped += 1;
            return;
        }
        link.skipped = 0;
        link.heard_at = at;
        if let Some(why) = link.closing {
            return self.end_link(why, Happening::Disconnected(reason::REMOTE_USER), soc);
        }
        self.parameters_step(at, soc);
        self.radio_step(at, soc);
        self.security_step(at, soc);
        let taken = self.laptop_step(at, soc);
        if self.link.is_none() {
            return;
        }
        self.payload_step(taken > 0, at, soc);
        let sent = self.send_step(at, soc);
        self.spend(rules::connection_event((taken + sent).max(1)), soc);
    }

    fn parameters_step(&mut self, at: u64, soc: &mut Soc) {
        let shortest = self.central.shortest_interval;
        let link = self.link.as_mut().expect("a link");
        let mut told = None;
        if let Some(wanted) = count_down(&mut link.asked) {
            link.content_at = at;
            let granted = wanted.max >= shortest;
            let [min, max, latency, supervision] = wanted.as_halves();
            self.central.tell(at, Happening::AskedFor { min, max, latency, supervision, granted });
            if granted {
                let interval = wanted.min.max(shortest);
                link.update = Some((Parameters { min: interval, max: interval, ..wanted }, 6));
            } else {
                told = Some(link.parameters);
            }
        }
        if let Some(new) = count_down(&mut link.update) {
            link.parameters = new;
            link.next_event = at + link.interval_cycles();
            self.central.tell(at, Happening::Interval(new.max));
            told = Some(new);
        }
        if let Some(parameters) = told {
            let update = SocEvent::gap(event::CONN_PARAM_UPDATE, HANDLE).halves(&parameters.as_halves());
            self.raise(update.finish(), &mut soc.nvic);
        }
    }

    /// Checks whether the laptop's packets show that it still has the keys.
    fn payload_step(&mut self, came: bool, at: u64, soc: &mut Soc) {
        let answers = self.central.answers_radio_pings;
        let link = self.link.as_mut().expect("a link");
        if came || answers || !link.encrypted {
            link.content_at = at;
        } else if at - link.content_at >= PAYLOAD_TIMEOUT {
            link.content_at = at;
            let timeout = SocEvent::gap(event::TIMEOUT, HANDLE).with(&[AUTHENTICATED_PAYLOAD]).finish();
            self.raise(timeout, &mut soc.nvic);
        }
    }

    fn radio_step(&mut self, at: u64, soc: &mut Soc) {
        let link = self.link.as_mut().expect("a link");
        let octets = count_down(&mut link.longer_in);
        let fast = tick(&mut link.fast_in);
        link.fast |= fast;
        if let Some(octets) = octets {
            link.data_length = octets;
            let update = SocEvent::gap(event::DATA_LENGTH_UPDATE, HANDLE)
                .halves(&[octets, octets, 2120, 2120])
                .finish();
            self.raise(update, &mut soc.nvic);
            self.central.tell(at, Happening::DataLength(octets));
        }
        if fast {
            let update = SocEvent::gap(event::PHY_UPDATE, HANDLE).with(&[0, 2, 2]).finish();
            self.raise(update, &mut soc.nvic);
        }
    }

    fn security_step(&mut self, at: u64, soc: &mut Soc) {
        self.advance_pairing(at, soc);
        let link = self.link.as_mut().expect("a link");
        if tick(&mut link.encrypted_in) {
            self.encrypted(soc);
            self.central.tell(at, Happening::Encrypted);
        }
    }

    /// Sends the laptop's data in this event, and returns the number of packets.
    fn laptop_step(&mut self, at: u64, soc: &mut Soc) -> u64 {
        let mut taken = 0;
        let mut commands = 0;
        loop {
            let link = self.link.as_ref().expect("a link");
            // Only one procedure may run at a time.
            let busy = link.mtu_asked.is_some()
                || link.pairing_asked.is_some()
                || link.pairing.is_some()
                || link.key_asked
                || link.encrypted_in.is_some();
            if busy {
                return taken;
            }
            let Some(command) = self.central.commands.front().cloned() else { return taken };
            taken += 1;
            match command {
                Command::WriteCommand(data) => {
                    if commands == COMMANDS_PER_EVENT {
                        return taken - 1;
                    }
                    commands += 1;
                    let _ = self.written(&data, false, soc);
                    self.central.commands.pop_front();
                    continue;
                }
                Command::Subscribe(on) => match self.subscribe(on, soc) {
                    Some(answer) => self.central.tell(at, Happening::Subscribed(answer)),
                    None => return taken,
                },
                Command::Write(data) => {
                    let answer = self.written(&data, true, soc);
                    self.central.tell(at, Happening::Written(answer));
                }
                Command::ExchangeMtu(mtu) => {
                    self.link.as_mut().expect("a link").mtu_asked = Some(mtu);
                    let request =
                        SocEvent::gatts(event::EXCHANGE_MTU_REQUEST, HANDLE).halves(&[mtu]).finish();
                    self.raise(request, &mut soc.nvic);
                }
                Command::FastRadio => {
                    let request = SocEvent::gap(event::PHY_UPDATE_REQUEST, HANDLE).with(&[2, 2]).finish();
                    self.raise(request, &mut soc.nvic);
                }
                Command::Pair { bond } => {
                    self.link.as_mut().expect("a link").pairing_asked = Some(bond);
                    // The laptop has no input and no output, and its keys have 7 to 16 bytes.
                    // The laptop distributes encryption and identity keys in both directions.
                    let flags = u8::from(bond) | 3 << 4;
                    let request =
                        SocEvent::gap(event::SEC_PARAMS_REQUEST, HANDLE).with(&[flags, 7, 16, 3, 3]);
                    self.raise(request.finish(), &mut soc.nvic);
                }
                Command::Encrypt => self.ask_for_key(at, soc),
                Command::Disconnect => {
                    self.central.commands.pop_front();
                    self.end_link(reason::REMOTE_USER, Happening::Disconnected(reason::LOCAL_HOST), soc);
                    return taken;
                }
            }
            self.central.commands.pop_front();
            return taken;
        }
    }

    fn ask_for_key(&mut self, at: u64, soc: &mut Soc) {
        let Some(bond) = self.central.bond else {
            return self.central.tell(at, Happening::KeyMissing);
        };
        self.link.as_mut().expect("a link").key_asked = true;
        let request = SocEvent::gap(event::SEC_INFO_REQUEST, HANDLE)
            .with(&[1 << 1])
            .with(&self.central.address)
            .with(&[0])
            .halves(&[bond.diversifier])
            .with(&bond.random)
            .with(&[1, 0]);
        self.raise(request.finish(), &mut soc.nvic);
    }

    /// Sends the notifications that fit in this event, and returns their number.
    fn send_step(&mut self, at: u64, soc: &mut Soc) -> u64 {
        let event_length = us(1250 * u64::from(self.config.event_length));
        let link = self.link.as_mut().expect("a link");
        let budget = event_length.min(link.interval_cycles()) - us(300);
        let mut time = us(250);
        let mut sent = 0;
        while let Some(next) = link.queue.front() {
            time += link.air_time(next.len());
            if time > budget && sent > 0 {
                break;
            }
            let bytes = link.queue.pop_front().expect("the front");
            self.central.notified.push((at + time, bytes));
            sent += 1;
        }
        if sent > 0 {
            let complete = SocEvent::gatts(event::HVN_TX_COMPLETE, HANDLE).with(&[sent as u8, 0]).finish();
            self.raise(complete, &mut soc.nvic);
        }
        sent
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_outside_the_standard_are_refused() {
        let good = Parameters { min: 6, max: 12, latency: 0, supervision: 200 };
        assert!(good.are_valid());
        assert!(!Parameters { min: 5, ..good }.are_valid());
        assert!(!Parameters { min: 13, ..good }.are_valid());
        assert!(!Parameters { latency: 499, ..good }.are_valid(), "15 s of silence and 2 s of patience");
    }

    #[test]
    fn long_packets_and_the_fast_radio_save_air_time() {
        let mut link = Connection::new(0, 24);
        let slow = link.air_time(244);
        link.data_length = 251;
        let long = link.air_time(244);
        link.fast = true;
        assert!(slow > long && long > link.air_time(244));
        // The event consists of 261 bytes at 1 Mbit/s, a gap, an empty packet, and another gap.
        assert_eq!(long, us(8 * 261 + 150 + 80 + 150));
    }
}
