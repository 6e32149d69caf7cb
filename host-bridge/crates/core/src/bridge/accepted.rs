//! How old a hand's sample is once the robot has shown that it acts on it.

use host_robot::Part;
use serde::Serialize;

/// From a hand's sample to the robot's own report that it acts on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Acceptance {
    /// The newest.
    pub age_ms: u64,
    /// The longest so far.
    pub worst_ms: u64,
    /// How many.
    pub count: u64,
}

/// The same for base and arm; `None` = the robot has not shown it yet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Accepted {
    /// Its odometry has begun to follow a changed speed.
    pub base: Option<Acceptance>,
    /// Its controller has taken a motion.
    pub arm: Option<Acceptance>,
}

/// Keeps count.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Acceptances {
    /// When the sample was taken that led to the newest command.
    asked_ms: [Option<u64>; 2],
    pub(super) seen: Accepted,
}

impl Acceptances {
    /// A command was made from a sample of this age.
    pub(super) fn ask(&mut self, part: Part, age_ms: u64, now_ms: u64) {
        self.asked_ms[part as usize] = Some(now_ms.saturating_sub(age_ms));
    }

    /// No command is pending any more.
    pub(super) fn forget(&mut self) {
        self.asked_ms = [None; 2];
    }

    /// The robot shows that it acts on the command. Returns the sample's age now, if a command was pending.
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

    #[test]
    fn an_age_runs_from_the_sample_to_the_robots_word_and_each_command_counts_once() {
        let mut all = Acceptances::default();
        assert_eq!(all.accept(Part::Base, 5), None, "nothing was asked");
        // A sample 12 ms old at 100 ms; the robot follows at 140 ms.
        all.ask(Part::Base, 12, 100);
        assert_eq!(all.accept(Part::Arm, 130), None, "another part");
        assert_eq!(all.accept(Part::Base, 140), Some(52));
        assert_eq!(all.accept(Part::Base, 150), None, "once");
        // A newer command takes the older one's place.
        all.ask(Part::Base, 5, 200);
        all.ask(Part::Base, 5, 220);
        assert_eq!(all.accept(Part::Base, 235), Some(20));
        assert_eq!(all.seen.base, Some(Acceptance { age_ms: 20, worst_ms: 52, count: 2 }));
        all.ask(Part::Arm, 0, 300);
        all.forget();
        assert_eq!((all.accept(Part::Arm, 310), all.seen.arm), (None, None));
    }
}
