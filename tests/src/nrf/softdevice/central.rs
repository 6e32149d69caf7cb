//! Simulates a laptop's Bluetooth, which finds the board, connects, pairs, subscribes, writes, and records events.
//!
//! Tests add [`Command`]s, which the laptop executes in order during connection events.
//! The laptop records [`Happening`]s, which the tests read.

use std::collections::VecDeque;

/// An action that the laptop performs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Command {
    /// Requests a larger ATT MTU.
    ExchangeMtu(u16),
    /// Requests the radio rate of 2 Mbit/s.
    FastRadio,
    /// Turns notifications on or off.
    Subscribe(bool),
    /// Pairs again, with or without storing the keys (bonding).
    Pair {
        /// Whether both sides store the keys.
        bond: bool,
    },
    /// Encrypts with the keys of the last bond.
    Encrypt,
    /// Writes and waits for the response.
    Write(Vec<u8>),
    /// Writes without response.
    WriteCommand(Vec<u8>),
    /// Ends the link.
    Disconnect,
}

/// An event that the laptop notices.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Happening {
    /// The link is established with this interval in units of 1.25 ms.
    Connected(u16),
    /// The link ended for one of the reasons in [`super::abi::reason`].
    Disconnected(u8),
    /// The board requested an interval within this range, in units of 1.25 ms.
    /// The board also requested this latency, and a supervision timeout in units of 10 ms.
    AskedFor {
        /// Shortest interval.
        min: u16,
        /// Longest interval.
        max: u16,
        /// Number of events that the board may skip.
        latency: u16,
        /// Supervision timeout: silence of this duration ends the link.
        supervision: u16,
        /// Whether the laptop agreed.
        granted: bool,
    },
    /// A new interval is used, in units of 1.25 ms.
    Interval(u16),
    /// The ATT MTU has this new value.
    Mtu(u16),
    /// A radio packet may have this many bytes.
    DataLength(u16),
    /// The pairing is complete.
    Paired {
        /// Whether the keys are stored.
        bonded: bool,
    },
    /// The link is encrypted with stored keys.
    Encrypted,
    /// The board does not have the keys, or no longer has them.
    KeyMissing,
    /// The board answered the subscription.
    Subscribed(bool),
    /// The board answered a write: accepted, or refused with this ATT error.
    Written(Result<(), u8>),
}

/// Keys that both sides have stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bond {
    /// The long term key.
    pub key: [u8; 16],
    /// The number of the key (EDIV).
    pub diversifier: u16,
    /// The random number of the key.
    pub random: [u8; 8],
}

/// A received advertisement.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Heard {
    /// Advertising data of the board.
    pub data: Vec<u8>,
    /// Scan response of the board.
    pub response: Vec<u8>,
}

impl Heard {
    /// Returns the content of the first structure of this type.
    pub fn part(&self, kind: u8) -> Option<&[u8]> {
        [&self.data, &self.response].into_iter().find_map(|bytes| {
            let mut rest = bytes.as_slice();
            while let [len, kind_here, ..] = *rest {
                let len = usize::from(len);
                if len > 0 && kind_here == kind {
                    return rest.get(2..=len);
                }
                rest = rest.get(1 + len..)?;
            }
            None
        })
    }
}

/// The simulated laptop.
#[derive(Clone, Debug)]
pub struct Central {
    /// The laptop's Bluetooth address.
    pub address: [u8; 6],
    /// Whether the laptop's radio is in range.
    pub in_range: bool,
    /// Whether the laptop connects as soon as it receives an advertisement.
    pub connects: bool,
    /// Interval of new connections in units of 1.25 ms.
    pub first_interval: u16,
    /// Shortest interval that the laptop accepts, in units of 1.25 ms.
    pub shortest_interval: u16,
    /// Whether the laptop supports long radio packets.
    pub long_packets: bool,
    /// Whether the laptop's radio answers LE Ping, as nearly all current radios do.
    pub answers_radio_pings: bool,
    /// Commands that the laptop has not executed yet.
    pub commands: VecDeque<Command>,
    /// Events with the cycles at which they occurred.
    pub log: Vec<(u64, Happening)>,
    /// Notifications, each with the cycle at which it was complete.
    pub notified: Vec<(u64, Vec<u8>)>,
    /// The last advertisement that was received.
    pub heard: Option<Heard>,
    /// Number of advertisements so far.
    pub advertisements: u64,
    /// Keys that are shared with the board.
    pub bond: Option<Bond>,
    lost_at: Option<u64>,
    connected: bool,
}

impl Default for Central {
    fn default() -> Self {
        Self {
            address: [0x11, 0x22, 0x33, 0x44, 0x55, 0xC6],
            in_range: true,
            connects: false,
            // Linux grants 30 ms by default, or the interval that a peripheral requests.
            first_interval: 24,
            shortest_interval: 6,
            long_packets: true,
            answers_radio_pings: true,
            commands: VecDeque::new(),
            log: Vec::new(),
            notified: Vec::new(),
            heard: None,
            advertisements: 0,
            bond: None,
            lost_at: None,
            connected: false,
        }
    }
}

impl Central {
    /// Adds commands for the laptop.
    pub fn order(&mut self, commands: impl IntoIterator<Item = Command>) {
        self.commands.extend(commands);
    }

    /// Returns whether the laptop has a link.
    pub fn is_connected(&self) -> bool {
        self.connected
    }

    /// Returns whether an event satisfies a condition.
    pub fn saw(&self, what: impl Fn(&Happening) -> bool) -> usize {
        self.log.iter().filter(|(_, h)| what(h)).count()
    }

    pub(super) fn tell(&mut self, at: u64, what: Happening) {
        match what {
            Happening::Connected(_) => self.connected = true,
            Happening::Disconnected(_) => self.connected = false,
            _ => {}
        }
        self.log.push((at, what));
    }

    /// The remaining commands belonged to the link that ended.
    pub(super) fn left(&mut self) {
        self.commands.clear();
    }

    /// After a restart, the board is silent. The laptop notices this at the given cycle.
    pub(super) fn silence(&mut self, noticed_at: u64) {
        self.lost_at = Some(noticed_at);
        self.left();
    }

    pub(super) fn may_connect(&self) -> bool {
        self.connects && self.in_range && !self.connected && self.lost_at.is_none()
    }

    pub(super) fn advance(&mut self, now: u64) {
        if self.lost_at.is_some_and(|at| at <= now) {
            self.lost_at = None;
            self.tell(now, Happening::Disconnected(super::abi::reason::TIMEOUT));
        }
    }

    pub(super) fn due(&self) -> Option<u64> {
        self.lost_at
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_of_an_advertisement_are_found_in_either_packet_and_damage_ends_the_search() {
        let heard = Heard { data: vec![2, 1, 6, 3, 0xFF, 1, 2], response: vec![3, 9, b'h', b'i', 0] };
        assert_eq!(heard.part(1), Some(&[6][..]));
        assert_eq!(heard.part(0xFF), Some(&[1, 2][..]));
        assert_eq!(heard.part(9), Some(&b"hi"[..]));
        assert_eq!(heard.part(7), None);
        let broken = Heard { data: vec![200, 1, 6], response: Vec::new() };
        assert_eq!(broken.part(1), None);
    }
}
