//! Models the time slots between radio events, in which the image writes flash.
//! The model is our own and not Nordic's.

use super::super::time::us;
use super::link::{Link, RAMPS};

/// Time that the library needs before a slot begins.
const LEAD: u64 = us(200);

/// A request for a time slot.
#[derive(Clone, Copy, Debug)]
pub(super) struct Request {
    pub(super) length: u64,
    pub(super) high: bool,
    pub(super) timeout: u64,
}

/// The state of a request for a slot.
#[derive(Clone, Copy, Debug, Default)]
pub(super) enum Slot {
    /// No slot has been requested.
    #[default]
    None,
    /// The slot begins at this cycle.
    Planned { at: u64, length: u64 },
    /// The slot's interrupt is pending.
    Pending { length: u64 },
    /// The slot will not be granted. The image learns this at this cycle.
    Blocked { at: u64 },
    /// The slot has begun and must end by this cycle.
    Running { until: u64 },
}

impl Slot {
    /// Plans the earliest slot that overlaps no connection event.
    /// A slot of high priority may overlap connection events, which are then missed.
    pub(super) fn plan(request: Request, link: Option<&Link>, now: u64) -> Self {
        let mut at = now + LEAD;
        let Some(link) = link.filter(|_| !request.high) else {
            return Self::Planned { at, length: request.length };
        };
        let mut event = link.next_event;
        let latest = at + request.timeout;
        while at <= latest {
            // Place the slot before the next event if it fits there, and otherwise after that event.
            if at + request.length <= event {
                return Self::Planned { at, length: request.length };
            }
            at = at.max(event + RAMPS + LEAD);
            event += link.interval;
            if request.length + RAMPS + LEAD > link.interval {
                break;
            }
        }
        Self::Blocked { at: latest }
    }

    /// Returns the cycle of the next change.
    pub(super) fn due(&self) -> Option<u64> {
        match self {
            Self::Planned { at, .. } | Self::Blocked { at } => Some(*at),
            _ => None,
        }
    }

    /// Returns whether the slot occupies the radio at this cycle.
    pub(super) fn holds(&self, at: u64) -> bool {
        match *self {
            Self::Planned { at: start, length } => (start..start + length).contains(&at),
            Self::Pending { .. } => true,
            Self::Running { until } => at < until,
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::time::ms;
    use super::*;

    #[test]
    fn a_slot_of_normal_priority_keeps_clear_of_events_and_is_refused_where_none_fits() {
        let request = Request { length: ms(5), high: false, timeout: ms(30) };
        let link = Link::new(1, [6, 0, 100], 0);
        let Slot::Planned { at, length } = Slot::plan(request, Some(&link), 0) else { panic!("fits") };
        assert!(at > link.next_event && at + length <= link.next_event + link.interval);
        let long = Request { length: ms(11), ..request };
        let Slot::Blocked { at } = Slot::plan(long, Some(&link), 0) else { panic!("does not fit") };
        assert_eq!(at, us(200) + ms(30));
        let high = Request { high: true, ..long };
        assert!(matches!(Slot::plan(high, Some(&link), 0), Slot::Planned { at, .. } if at == us(200)));
        assert!(matches!(Slot::plan(long, None, 0), Slot::Planned { .. }));
    }
}
