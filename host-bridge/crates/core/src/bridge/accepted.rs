//! Measures the age of a hand's sample when the robot reports its effect.

use host_robot::{Part, Report};
use serde::Serialize;

/// The time from a hand's sample to the robot's report of its effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Acceptance {
    /// The newest.
    pub age_ms: u64,
    /// The longest so far.
    pub worst_ms: u64,
    /// How many.
    pub count: u64,
}

/// The values for base and arm; `None` if the robot has not reported any effect.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Accepted {
    /// Ages of samples when the odometry begins to follow a new speed.
    pub base: Option<Acceptance>,
    /// Ages of samples when the controller accepts a motion.
    pub arm: Option<Acceptance>,
}

/// Collects these values.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Acceptances {
    /// Time of the sample that led to the newest command.
    asked_ms: [Option<u64>; 2],
    pub(super) seen: Accepted,
}

impl Acceptances {
    /// Records a command from a sample of this age.
    pub(super) fn ask(&mut self, part: Part, age_ms: u64, now_ms: u64) {
        self.asked_ms[part as usize] = Some(now_ms.saturating_sub(age_ms));
    }

    /// Discards all pending commands.
    pub(super) fn forget(&mut self) {
        self.asked_ms = [None; 2];
    }

    /// Forgets the arm's pending command if its motion was refused or did not reach its end.
    /// Otherwise, the start of the next motion would be attributed to that command.
    pub(super) fn see(&mut self, report: &Report) {
        if matches!(report, Report::MotionRefused { .. } | Report::MotionEnded { reached: false, .. }) {
            self.asked_ms[Part::Arm as usize] = None;
        }
    }

    /// Records that the robot acts on a command.
    /// Returns the current age of the sample if a command was pending.
    pub(super) fn accept(&mut self, part: Part, now_ms: u64) -> Option<u64> {
        let age_ms = now_ms.saturating_sub(self.asked_ms[part as usize].take()?);
        let seen = match part {
            Part::Base => &mut self.seen.base,
            Part::Arm => &mut self.seen.arm,
        };
        let before = seen.map_or((0, 0), |before| (before.worst_ms, before.count));
        *seen = Some(Acceptance { age_ms, worst_ms: before.0.max(age_ms), count: before.1 + 1 });
        Some(age_ms)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use host_robot::MotionName;

    #[test]
    fn what_the_arm_takes_after_a_motion_that_was_refused_or_halted_is_not_counted_as_that_one() {
        let motion = MotionName::from("pick-up");
        let ended = |reached| Report::MotionEnded { motion: motion.clone(), reached };
        let refused = Report::MotionRefused { motion: motion.clone(), reason: String::new() };
        for (report, counts) in [(refused, None), (ended(false), None), (ended(true), Some(400))] {
            let mut all = Acceptances::default();
            all.ask(Part::Arm, 0, 100);
            all.ask(Part::Base, 0, 100);
            all.see(&report);
            // A hand moves the tool, which no gesture has requested.
            assert_eq!(all.accept(Part::Arm, 500), counts, "{report:?}");
            assert_eq!(all.accept(Part::Base, 140), Some(40));
        }
    }

    #[test]
    fn an_age_runs_from_the_sample_to_the_robots_word_and_each_command_counts_once() {
        let mut all = Acceptances::default();
        assert_eq!(all.accept(Part::Base, 5), None, "nothing was asked");
        // The sample is 12 ms old at time 100 ms, and the robot follows at 140 ms.
        all.ask(Part::Base, 12, 100);
        assert_eq!(all.accept(Part::Arm, 130), None, "another part");
        assert_eq!(all.accept(Part::Base, 140), Some(52));
        assert_eq!(all.accept(Part::Base, 150), None, "once");
        // A newer command replaces the older one.
        all.ask(Part::Base, 5, 200);
        all.ask(Part::Base, 5, 220);
        assert_eq!(all.accept(Part::Base, 235), Some(20));
        assert_eq!(all.seen.base, Some(Acceptance { age_ms: 20, worst_ms: 52, count: 2 }));
        all.ask(Part::Arm, 0, 300);
        all.forget();
        assert_eq!((all.accept(Part::Arm, 310), all.seen.arm), (None, None));
    }
}
