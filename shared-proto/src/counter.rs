//! Interprets the wrapping numbers in a state. They reveal lost frames and the events since the last frame.
//!
//! For each state, call [`SequenceTracker::see`] first, ignore states that are not new, and then update the event counters.
//! After a [`Hello`](crate::message::Hello) with a new boot id, call `rebase` on all trackers and counters.

/// Converts a wrapping counter of events to the number of new events.
///
/// The first value is the reference, because earlier events are not new.
/// A repeated frame gives 0, and a frame after lost frames gives all events since the last received frame.
///
/// ```
/// # use shared_proto::counter::CounterTracker;
/// let mut bends = CounterTracker::new();
/// assert_eq!(bends.see(254), 0); // the base
/// assert_eq!(bends.see(255), 1);
/// assert_eq!(bends.see(255), 0); // the same frame again
/// assert_eq!(bends.see(1), 2); // the frame with 0 was lost, its event is not
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CounterTracker {
    last: Option<u8>,
}

impl CounterTracker {
    /// The maximum increase that counts as events.
    /// A larger difference counts as a step backwards.
    /// A hand needs several minutes for 127 events.
    pub const MOST: u8 = 127;

    /// Creates a tracker without a reference.
    pub const fn new() -> Self {
        Self { last: None }
    }

    /// Returns the number of events since the last value, at most [`Self::MOST`].
    /// A larger increase means a restart or a very long silence.
    /// The method then returns 0 and sets a new reference.
    pub fn see(&mut self, value: u8) -> u8 {
        let new = value.wrapping_sub(self.last.unwrap_or(value));
        self.last = Some(value);
        if new > Self::MOST { 0 } else { new }
    }

    /// Forgets the reference, because the board has restarted.
    pub fn rebase(&mut self) {
        self.last = None;
    }
}

/// How the sequence number of a frame relates to earlier numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// The frame is newer than all earlier frames.
    New {
        /// Number of frames that are missing between the last frame and this frame.
        lost: u16,
    },
    /// The frame has the same number as the last frame. Ignore it.
    Duplicate,
    /// The frame is older than the last frame. Ignore it.
    /// Several such frames in a row mean that the board has restarted and its hello was lost.
    /// In this case, send a [`HelloRequest`](crate::message::HostMessage::HelloRequest).
    Old,
}

/// Tracks the sequence numbers of one kind of message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SequenceTracker {
    last: Option<u16>,
}

impl SequenceTracker {
    /// Creates a tracker without a reference.
    pub const fn new() -> Self {
        Self { last: None }
    }

    /// Classifies a sequence number. The first number counts as new, without lost frames.
    pub fn see(&mut self, sequence: u16) -> Order {
        let step = match self.last {
            None => 1,
            Some(last) => sequence.wrapping_sub(last),
        };
        match step {
            0 => Order::Duplicate,
            // Half of the range counts as ahead, which is 11 minutes of left-hand states at 50 Hz.
            1..0x8000 => {
                self.last = Some(sequence);
                Order::New { lost: step - 1 }
            }
            _ => Order::Old,
        }
    }

    /// Forgets the reference, because the board has restarted.
    pub fn rebase(&mut self) {
        self.last = None;
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    #[test]
    fn a_restart_adds_no_events() {
        let mut events = CounterTracker::new();
        events.see(200);
        events.rebase();
        assert_eq!(events.see(3), 0);
        assert_eq!(events.see(4), 1);
    }

    #[test]
    fn a_restart_that_nobody_noticed_adds_no_events_either() {
        let mut events = CounterTracker::new();
        events.see(5);
        assert_eq!(events.see(0), 0);
        assert_eq!(events.see(1), 1);
    }

    #[test]
    fn sequence_numbers_wrap() {
        let mut sequence = SequenceTracker::new();
        assert_eq!(sequence.see(65_534), Order::New { lost: 0 });
        assert_eq!(sequence.see(65_535), Order::New { lost: 0 });
        assert_eq!(sequence.see(0), Order::New { lost: 0 });
        assert_eq!(sequence.see(3), Order::New { lost: 2 });
        assert_eq!(sequence.see(3), Order::Duplicate);
        assert_eq!(sequence.see(65_535), Order::Old);
        assert_eq!(sequence.see(4), Order::New { lost: 0 });
    }

    proptest! {
        /// Whatever frames are lost, repeated or late, the receiver counts exactly the events since the first frame.
        #[test]
        fn no_loss_repetition_or_reordering_changes_the_sum_of_events(
            first_count: u8,
            first_sequence: u16,
            frames in prop::collection::vec((0u8..4, 0u8..10), 1..200),
        ) {
            let (mut count, mut sequence) = (first_count, first_sequence);
            let mut line: Vec<(u16, u8)> = Vec::new();
            let mut held = None;
            let (mut total, mut base, mut newest) = (0u32, None, 0u32);
            for (new_events, fate) in frames {
                count = count.wrapping_add(new_events);
                total += u32::from(new_events);
                sequence = sequence.wrapping_add(1);
                let frame = (sequence, count);
                match fate {
                    0 | 1 => continue,
                    2 => line.extend([frame, frame]),
                    3 => {
                        // This frame arrives after the next frame, unless the next frame has replaced it.
                        if base.is_some() && held.is_none() {
                            held = Some(frame);
                        }
                        continue;
                    }
                    _ => line.push(frame),
                }
                line.extend(held.take());
                base.get_or_insert(total);
                newest = total;
            }
            let (mut order, mut events) = (SequenceTracker::new(), CounterTracker::new());
            let mut seen = 0;
            for (sequence, count) in line {
                if let Order::New { .. } = order.see(sequence) {
                    seen += u32::from(events.see(count));
                }
            }
            // A frame has at most 4 events, so a gap of 127 needs 32 consecutive lost frames.
            prop_assert_eq!(seen, newest - base.unwrap_or(newest));
        }
    }
}
