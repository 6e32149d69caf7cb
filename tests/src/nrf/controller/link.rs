//! A connection's time, which bumble's link does not have: packets pass at connection events only, as many as fit; events
//! are missed out of range and during time slots; silence ends the connection. All figures that rest on this are modelled.

use std::collections::VecDeque;

use super::super::time::{ms, us};

/// A unit of the interval.
const UNIT: u64 = us(1250);
/// Bytes of a packet without the data length extension.
pub(super) const SHORT: u16 = 27;
/// And with it.
pub(super) const LONG: u16 = 251;
/// Of an event, by the controller's default.
const LONGEST_EVENT: u64 = us(7500);
/// Preamble, address, header, check and message integrity of a packet, in bytes.
const OVERHEAD: u64 = 14;
/// Between two packets.
const SPACE: u64 = us(150);
/// The radio's work before the first and after the last packet.
pub(super) const RAMPS: u64 = us(500);

/// A connection as the radio has it.
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
    /// HCI data packets of the board that wait for an event.
    pub(super) up: VecDeque<Vec<u8>>,
    /// Packets and events for the board that come over the air.
    pub(super) down: VecDeque<Vec<u8>>,
    /// Events so far, and those that were missed.
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

    /// Interval in 1.25 ms, latency in events, supervision in 10 ms.
    pub(super) fn set(&mut self, [interval, latency, supervision]: [u16; 3]) {
        self.interval = u64::from(interval) * UNIT;
        self.latency = latency;
        self.supervision = ms(10 * u64::from(supervision));
    }

    /// Cycle at which the connection is given up.
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

    /// An event: what passes up and down. The board sleeps through it if its latency allows and it has nothing to say.
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
        // 1 Mbit/s, packets of 27 bytes: a packet of 251 takes ten of them, 4.6 ms with spaces; one fits beside an answer.
        assert_eq!(link.event(false).0.len(), 1);
        // Long packets: 2.3 ms each, and an empty answer 0.3 ms.
        (link.octets, link.up) = (LONG, (0..20).map(|_| vec![0; 5 + 251]).collect());
        assert_eq!(link.event(false).0.len(), 2);
        // At 2 Mbit/s: 1.2 ms and 0.2 ms.
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
        // What the board has to say goes at once.
        link.up.push_back(vec![0; 30]);
        assert_eq!(link.event(false).0.len(), 1);
    }
}
