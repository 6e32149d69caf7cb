//! Models the timing of a connection, because bumble's link has none.
//! Packets pass only at connection events, and each event carries only as many packets as fit.
//! The link misses events when the laptop is out of range, and during time slots.
//! Silence ends the connection.
//! All figures that depend on this timing are modelled.

use std::collections::VecDeque;

use super::super::time::{ms, us};

/// The unit of connection intervals.
const UNIT: u64 = us(1250);
/// Maximum payload of a packet without the data length extension, in bytes.
pub(super) const SHORT: u16 = 27;
/// Maximum payload of a packet with the data length extension, in bytes.
pub(super) const LONG: u16 = 251;
/// Maximum duration of a connection event, which is the controller's default.
const LONGEST_EVENT: u64 = us(7500);
/// Overhead of a packet in bytes: preamble, address, header, checksum and message integrity code.
const OVERHEAD: u64 = 14;
/// Time between two packets.
const SPACE: u64 = us(150);
/// Time that the radio needs before the first packet and after the last packet.
pub(super) const RAMPS: u64 = us(500);

/// The radio's view of a connection.
#[derive(Clone, Debug)]
pub(super) struct Link {
    pub(super) handle: u16,
    pub(super) interval: u64,
    pub(super) latency: u16,
    pub(super) supervision: u64,
    pub(super) next_event: u64,
    pub(super) heard_at: u64,
    pub(super) octets: u16,
    pub(super) fast: bool,
    skipped: u16,
    /// HCI data packets from the board that wait for a connection event.
    pub(super) up: VecDeque<Vec<u8>>,
    /// Packets and events that arrive for the board over the air.
    pub(super) down: VecDeque<Vec<u8>>,
    /// Number of connection events so far, and number of missed connection events.
    pub(super) events: u64,
    pub(super) missed: u64,
}

impl Link {
    pub(super) fn new(handle: u16, [interval, latency, supervision]: [u16; 3], now: u64) -> Self {
        let mut link = Self {
            handle,
            interval: 0,
            latency: 0,
            supervision: 0,
            next_event: now + us(2500),
            heard_at: now,
            octets: SHORT,
            fast: false,
            skipped: 0,
            up: VecDeque::new(),
            down: VecDeque::new(),
            events: 0,
            missed: 0,
        };
        link.set([interval, latency, supervision]);
        link
    }

    /// Sets the interval (in 1.25 ms), the latency (in events) and the supervision time-out (in 10 ms).
    pub(super) fn set(&mut self, [interval, latency, supervision]: [u16; 3]) {
        self.interval = u64::from(interval) * UNIT;
        self.latency = latency;
        self.supervision = ms(10 * u64::from(supervision));
    }

    /// Returns the cycle at which the connection is given up.
    pub(super) fn lost_at(&self) -> u64 {
        self.heard_at + self.supervision
    }

    fn air(&self, bytes: usize) -> u64 {
        let octets = u64::from(self.octets);
        let packets = (bytes as u64).div_ceil(octets).max(1);
        let bits = 8 * (bytes as u64 + packets * OVERHEAD);
        let on_air = if self.fast { us(bits) / 2 } else { us(bits) };
        on_air + packets * SPACE
    }

    /// Performs a connection event. Returns the packets that pass from the board and to the board.
    /// The board sleeps through the event if its latency allows this and it has nothing to send.
    pub(super) fn event(&mut self, is_missed: bool) -> (Vec<Vec<u8>>, Vec<Vec<u8>>) {
        let at = self.next_event;
        self.next_event += self.interval;
        self.events += 1;
        if is_missed {
            self.missed += 1;
            return Default::default();
        }
        if self.up.is_empty() && self.skipped < self.latency {
            self.skipped += 1;
            return Default::default();
        }
        self.skipped = 0;
        self.heard_at = at;
        let mut left = self.interval.min(LONGEST_EVENT) - RAMPS;
        let (mut up, mut down) = (Vec::new(), Vec::new());
        while !self.up.is_empty() || !self.down.is_empty() {
            let bytes =
                |queue: &VecDeque<Vec<u8>>| queue.front().map_or(0, |packet| packet.len().saturating_sub(5));
            let cost = self.air(bytes(&self.up)) + self.air(bytes(&self.down));
            let Some(rest) = left.checked_sub(cost) else { break };
            left = rest;
            up.extend(self.up.pop_front());
            down.extend(self.down.pop_front());
        }
        (up, down)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn link() -> Link {
        Link::new(1, [6, 0, 100], 0)
    }

    #[test]
    fn an_event_carries_what_fits_into_it_and_the_rest_waits() {
        let mut link = link();
        link.up.extend((0..20).map(|_| vec![0; 5 + 251]));
        // At 1 Mbit/s, 251 bytes take ten packets of 27 bytes, or 4.6 ms with the spaces.
        // An event therefore has room for only one such block and an answer.
        assert_eq!(link.event(false).0.len(), 1);
        // A long packet takes 2.3 ms, and an empty answer takes 0.3 ms.
        (link.octets, link.up) = (LONG, (0..20).map(|_| vec![0; 5 + 251]).collect());
        assert_eq!(link.event(false).0.len(), 2);
        // At 2 Mbit/s, the times are 1.2 ms and 0.2 ms.
        (link.fast, link.up) = (true, (0..20).map(|_| vec![0; 5 + 251]).collect());
        assert_eq!(link.event(false).0.len(), 4);
        assert_eq!(link.up.len(), 16);
    }

    #[test]
    fn missed_events_carry_nothing_and_let_the_supervision_run() {
        let mut link = link();
        link.up.push_back(vec![0; 30]);
        let before = link.lost_at();
        assert!(link.event(true).0.is_empty());
        assert_eq!(link.lost_at(), before);
        assert_eq!(link.event(false).0.len(), 1);
        assert_eq!(link.lost_at(), us(2500) + ms(1000) + us(7500));
    }

    #[test]
    fn with_latency_the_silent_board_sleeps_through_events_and_hears_late() {
        let mut link = link();
        link.latency = 3;
        link.down.push_back(vec![0; 30]);
        let heard: Vec<usize> = (0..4).map(|_| link.event(false).1.len()).collect();
        assert_eq!(heard, [0, 0, 0, 1]);
        // If the board has something to send, it sends at the next event.
        link.up.push_back(vec![0; 30]);
        assert_eq!(link.event(false).0.len(), 1);
    }
}
