//! Stores faults, so that laptops that connect later receive them.

use crate::FrameOut;
use shared_proto::message::{BoardBody, Fault};

const KEPT: usize = 4;

/// The first fault of each kind since the start, and the newest fault: at most four in total.
#[derive(Clone, Copy, Debug, Default)]
pub struct FaultLog {
    kept: [Option<Fault>; KEPT],
}

impl FaultLog {
    /// Creates an empty log.
    pub const fn new() -> Self {
        Self { kept: [None; KEPT] }
    }

    /// Stores and sends a fault. If there is no room, the new fault replaces the newest stored fault.
    pub fn report(&mut self, fault: Fault, out: &mut impl FrameOut) {
        let same = self.kept.iter().position(|f| f.is_some_and(|f| f.kind == fault.kind));
        let free = self.kept.iter().position(Option::is_none);
        self.kept[same.or(free).unwrap_or(KEPT - 1)] = Some(fault);
        crate::send::<{ Fault::FRAME_MAX }>(&fault, out);
    }

    /// Sends all stored faults.
    pub fn repeat(&self, out: &mut impl FrameOut) {
        for fault in self.kept.iter().flatten() {
            crate::send::<{ Fault::FRAME_MAX }>(fault, out);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn one_fault_of_each_kind_is_kept_and_the_newest_gives_way() {
        let mut log = FaultLog::new();
        let mut ignore = |_: &[u8]| true;
        let fault = |kind, detail| Fault { uptime_ms: 1, kind, detail };
        for kind in 0..6u8 {
            log.report(fault(kind.into(), 1), &mut ignore);
            log.report(fault(kind.into(), 2), &mut ignore);
        }
        let kinds: Vec<u8> = log.kept.iter().flatten().map(|fault| fault.kind.into()).collect();
        assert_eq!(kinds, [0, 1, 2, 5]);
        assert!(log.kept.iter().flatten().all(|fault| fault.detail == 2), "the newest of its kind");
        let mut frames = 0;
        log.repeat(&mut |_: &[u8]| {
            frames += 1;
            true
        });
        assert_eq!(frames, 4);
    }
}
