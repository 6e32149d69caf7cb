//! Converts the flex readings of two fingers to bend counters and a stop flag.
//!
//! A finger is *bent* above [`BENT_PERMILLE`] of the range from calibrated rest to calibrated bend.
//! A finger is *straight* below [`STRAIGHT_PERMILLE`]. Between the two thresholds, its state does not change.
//! A change must persist for two samples.
//!
//! A bend is counted once. It is counted when the other finger has been straight for [`CONFIRM_MS`].
//! If the bent finger is released earlier, the bend is counted at the release.
//! Therefore, bending both fingers for a **stop** counts no bend:
//!
//! ```text
//!           one bent               other straight for 100 ms, or released: count it
//!   Open ──────────────▶ Pending ─────────────────────▶ Counted ──▶ Open (when released)
//!                           │                              │
//!                           ▼ the other one bends too      ▼
//!                          Both ──▶ Stopped after 300 ms ──▶ Closing ──▶ Open (when both straight)
//! ```

/// Threshold above which a finger is bent, in thousandths of the calibrated range.
pub const BENT_PERMILLE: i16 = 450;
/// Threshold below which a finger is straight again.
pub const STRAIGHT_PERMILLE: i16 = 250;
/// Time for which the other finger must stay straight before a held bend is counted.
pub const CONFIRM_MS: u32 = 100;
/// Time for which both fingers must stay bent to stop the robot.
pub const STOP_MS: u32 = 300;
/// Minimum duration of the stop flag, so that a few lost frames cannot hide it.
pub const STOP_SHOWN_MS: u32 = 500;
/// Number of consecutive samples that must agree: 20 ms at 100 Hz.
pub const DEBOUNCE_SAMPLES: u8 = 2;

/// One of the two fingers with a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finger {
    /// Makes the robot faster.
    Index,
    /// Makes the robot slower.
    Middle,
}

impl Finger {
    fn other(self) -> Self {
        match self {
            Finger::Index => Finger::Middle,
            Finger::Middle => Finger::Index,
        }
    }
}

/// Returns `part` / `whole` in thousandths, rounded down, at most 2047.
/// The result is 0 if `whole` is 0.
/// Both arguments must be below 2^21.
///
/// The code uses only subtractions and shifts, because an 8-bit board has no divider and only these eleven bits are needed.
pub fn permille(part: u32, whole: u32) -> u16 {
    if whole == 0 {
        return 0;
    }
    let mut rest = part * 1000;
    let mut step = whole << 10;
    let mut quotient = 0;
    for _ in 0..11 {
        quotient <<= 1;
        if rest >= step {
            rest -= step;
            quotient |= 1;
        }
        step >>= 1;
    }
    quotient
}

/// Returns how far a finger is bent: 0 = rest, 1000 = calibrated bend. The readings may rise or fall with the bend.
///
/// The result is within ±2047. If rest and bend are equal, it is 0 (never bent).
pub fn bend_permille(reading: u16, rest: u16, bend: u16) -> i16 {
    let size = permille(u32::from(reading.abs_diff(rest)), u32::from(bend.abs_diff(rest))) as i16;
    if (reading < rest) == (bend < rest) { size } else { -size }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FingerPose {
    Unknown,
    Straight,
    Bent,
}

/// Hysteresis and debouncing of one finger.
#[derive(Clone, Copy, Debug)]
struct Hysteresis {
    pose: FingerPose,
    against: u8,
    permille: i16,
}

impl Hysteresis {
    const UNKNOWN: Self = Self { pose: FingerPose::Unknown, against: 0, permille: 0 };

    fn step(&mut self, permille: i16) {
        self.permille = permille;
        let wanted = if permille > BENT_PERMILLE {
            FingerPose::Bent
        } else if permille < STRAIGHT_PERMILLE {
            FingerPose::Straight
        } else {
            self.pose
        };
        if wanted == self.pose {
            self.against = 0;
            return;
        }
        self.against += 1;
        if self.against >= DEBOUNCE_SAMPLES {
            self.pose = wanted;
            self.against = 0;
        }
    }

    fn is_bent(&self) -> bool {
        self.pose == FingerPose::Bent
    }

    /// Returns whether the finger is neither bent nor about to become bent.
    fn is_at_rest(&self) -> bool {
        self.pose == FingerPose::Straight && self.permille < STRAIGHT_PERMILLE
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Open,
    Pending { finger: Finger, since_ms: u32 },
    Counted { finger: Finger },
    Both { since_ms: u32 },
    Stopped { since_ms: u32 },
    Closing,
}

/// The counters of bends, and the stop flag.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Bends {
    /// Number of bends of the index finger since the start. The number wraps.
    pub index: u8,
    /// Number of bends of the middle finger since the start. The number wraps.
    pub middle: u8,
    /// Both fingers have been held bent for 300 ms.
    pub stop: bool,
}

/// Counts the bends of two fingers and detects the stop gesture.
#[derive(Clone, Copy, Debug)]
pub struct FlexDetector {
    index: Hysteresis,
    middle: Hysteresis,
    phase: Phase,
    bends: Bends,
}

impl Default for FlexDetector {
    fn default() -> Self {
        Self::new()
    }
}

impl FlexDetector {
    /// Creates a detector that counts nothing until both fingers have been straight once.
    pub fn new() -> Self {
        Self {
            index: Hysteresis::UNKNOWN,
            middle: Hysteresis::UNKNOWN,
            phase: Phase::Closing,
            bends: Bends::default(),
        }
    }

    /// Forgets the current state of the fingers but keeps the counters.
    /// Both fingers must be straight before anything counts.
    pub fn disarm(&mut self) {
        *self = Self { bends: Bends { stop: false, ..self.bends }, ..Self::new() };
    }

    /// Returns the current counters.
    pub fn bends(&self) -> Bends {
        self.bends
    }

    /// Adds a sample: how far each finger is bent (see [`bend_permille`]) at `now_ms`, on a clock that wraps.
    #[inline(never)]
    pub fn step(&mut self, index_permille: i16, middle_permille: i16, now_ms: u32) -> Bends {
        self.index.step(index_permille);
        self.middle.step(middle_permille);
        let (index, middle) = (self.index.is_bent(), self.middle.is_bent());
        let since = |then: u32| now_ms.wrapping_sub(then);

        self.phase = match self.phase {
            Phase::Both { since_ms } if index && middle => {
                if since(since_ms) >= STOP_MS {
                    self.bends.stop = true;
                    Phase::Stopped { since_ms: now_ms }
                } else {
                    self.phase
                }
            }
            Phase::Stopped { since_ms } => {
                if (index && middle) || since(since_ms) < STOP_SHOWN_MS {
                    self.phase
                } else {
                    self.bends.stop = false;
                    Phase::Closing
                }
            }
            _ if index && middle => Phase::Both { since_ms: now_ms },
            Phase::Both { .. } => Phase::Closing,
            Phase::Closing => {
                if self.index.pose == FingerPose::Straight && self.middle.pose == FingerPose::Straight {
                    Phase::Open
                } else {
                    Phase::Closing
                }
            }
            Phase::Open => match (index, middle) {
                (true, _) => Phase::Pending { finger: Finger::Index, since_ms: now_ms },
                (_, true) => Phase::Pending { finger: Finger::Middle, since_ms: now_ms },
                _ => Phase::Open,
            },
            Phase::Pending { finger, since_ms } => {
                if !self.of(finger).is_bent() {
                    self.count(finger);
                    Phase::Open
                } else if since(since_ms) >= CONFIRM_MS && self.of(finger.other()).is_at_rest() {
                    self.count(finger);
                    Phase::Counted { finger }
                } else {
                    self.phase
                }
            }
            Phase::Counted { finger } => {
                if self.of(finger).is_bent() {
                    self.phase
                } else {
                    Phase::Open
                }
            }
        };
        self.bends
    }

    fn of(&self, finger: Finger) -> &Hysteresis {
        match finger {
            Finger::Index => &self.index,
            Finger::Middle => &self.middle,
        }
    }

    fn count(&mut self, finger: Finger) {
        let counter = match finger {
            Finger::Index => &mut self.bends.index,
            Finger::Middle => &mut self.bends.middle,
        };
        *counter = counter.wrapping_add(1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Feeds a detector at 100 Hz.
    struct Hand {
        detector: FlexDetector,
        now_ms: u32,
    }

    impl Hand {
        fn open() -> Self {
            // The clock starts shortly before it wraps, so that every test includes a wrap.
            let mut hand = Self { detector: FlexDetector::new(), now_ms: u32::MAX - 50 };
            hand.hold(0, 0, 100);
            hand
        }

        fn hold(&mut self, index: i16, middle: i16, ms: u32) -> (u8, u8, bool) {
            for _ in 0..ms / 10 {
                self.now_ms = self.now_ms.wrapping_add(10);
                self.detector.step(index, middle, self.now_ms);
            }
            let bends = self.detector.bends();
            (bends.index, bends.middle, bends.stop)
        }
    }

    #[test]
    fn a_bend_counts_once_however_long_it_is_held() {
        let mut hand = Hand::open();
        assert_eq!(hand.hold(800, 0, 10_000), (1, 0, false));
        assert_eq!(hand.hold(0, 0, 100), (1, 0, false));
        assert_eq!(hand.hold(0, 800, 10_000), (1, 1, false));
        assert_eq!(hand.hold(0, 0, 100), (1, 1, false));
    }

    #[test]
    fn a_held_bend_counts_within_130_ms_and_a_short_one_at_its_release() {
        let mut hand = Hand::open();
        assert_eq!(hand.hold(800, 0, 100), (0, 0, false));
        assert_eq!(hand.hold(800, 0, 30), (1, 0, false));
        let mut hand = Hand::open();
        assert_eq!(hand.hold(800, 0, 50), (0, 0, false));
        assert_eq!(hand.hold(0, 0, 20), (1, 0, false));
    }

    #[test]
    fn chatter_about_one_threshold_counts_once() {
        let mut hand = Hand::open();
        for _ in 0..100 {
            hand.hold(460, 0, 30);
            hand.hold(260, 0, 30);
        }
        assert_eq!(hand.hold(0, 0, 100), (1, 0, false));
    }

    #[test]
    fn a_single_sample_is_no_bend_and_no_release() {
        let mut hand = Hand::open();
        for _ in 0..50 {
            hand.hold(1000, 0, 10);
            assert_eq!(hand.hold(0, 0, 50), (0, 0, false));
        }
        hand.hold(1000, 0, 200);
        for _ in 0..50 {
            hand.hold(0, 0, 10);
            assert_eq!(hand.hold(1000, 0, 50), (1, 0, false));
        }
    }

    #[test]
    fn both_fingers_for_300_ms_mean_stop_and_count_nothing() {
        let mut hand = Hand::open();
        assert_eq!(hand.hold(900, 900, 310), (0, 0, false));
        assert_eq!(hand.hold(900, 900, 20), (0, 0, true));
        assert_eq!(hand.hold(900, 900, 60_000), (0, 0, true));
        assert_eq!(hand.hold(0, 0, 30), (0, 0, false));
        assert_eq!(hand.hold(800, 0, 200), (1, 0, false));
    }

    #[test]
    fn stop_is_shown_for_half_a_second_at_least() {
        let mut hand = Hand::open();
        hand.hold(900, 900, 330);
        assert_eq!(hand.hold(0, 0, 480), (0, 0, true));
        assert_eq!(hand.hold(0, 0, 40), (0, 0, false));
    }

    #[test]
    fn both_fingers_for_less_than_300_ms_do_nothing() {
        let mut hand = Hand::open();
        hand.hold(900, 900, 300);
        assert_eq!(hand.hold(0, 0, 1000), (0, 0, false));
    }

    #[test]
    fn fingers_that_close_one_after_the_other_count_nothing() {
        let mut hand = Hand::open();
        hand.hold(900, 0, 80);
        hand.hold(900, 900, 200);
        assert_eq!(hand.hold(0, 0, 100), (0, 0, false));
        // The fingers close more slowly,
        // but the second finger is already moving while the first finger is bent.
        hand.hold(900, 0, 60);
        hand.hold(900, 350, 300);
        hand.hold(900, 900, 200);
        assert_eq!(hand.hold(0, 0, 100), (0, 0, false));
    }

    #[test]
    fn while_both_are_bent_nothing_counts_and_the_rest_of_a_fist_counts_neither() {
        let mut hand = Hand::open();
        assert_eq!(hand.hold(900, 0, 200), (1, 0, false));
        assert_eq!(hand.hold(900, 900, 100), (1, 0, false));
        // The fingers straighten one after the other.
        assert_eq!(hand.hold(0, 900, 500), (1, 0, false));
        assert_eq!(hand.hold(0, 0, 50), (1, 0, false));
        assert_eq!(hand.hold(0, 900, 200), (1, 1, false));
    }

    #[test]
    fn a_neighbour_that_moves_along_a_little_delays_a_bend_but_does_not_lose_it() {
        let mut hand = Hand::open();
        assert_eq!(hand.hold(900, 350, 1000), (0, 0, false));
        assert_eq!(hand.hold(0, 0, 50), (1, 0, false));
    }

    #[test]
    fn a_finger_bent_at_start_or_after_a_fault_does_not_count() {
        let mut hand = Hand { detector: FlexDetector::new(), now_ms: 0 };
        assert_eq!(hand.hold(900, 0, 1000), (0, 0, false));
        assert_eq!(hand.hold(0, 0, 50), (0, 0, false));
        assert_eq!(hand.hold(900, 0, 200), (1, 0, false));
        hand.detector.disarm();
        assert_eq!(hand.hold(900, 0, 1000), (1, 0, false));
        hand.hold(0, 0, 50);
        assert_eq!(hand.hold(900, 0, 200), (2, 0, false));
    }

    #[test]
    fn counters_wrap() {
        let mut hand = Hand::open();
        for _ in 0..256 {
            hand.hold(900, 0, 150);
            hand.hold(0, 0, 50);
        }
        assert_eq!(hand.hold(0, 0, 10), (0, 0, false));
    }

    #[test]
    fn a_share_is_rounded_down_and_bounded() {
        for whole in [1, 3, 7, 1000, 8184, 2_000_000_u32] {
            for part in [0, 1, 2, 6, 999, 1001, 4092, 8184, 1_234_567_u32] {
                let exact = (u64::from(part) * 1000 / u64::from(whole)).min(2047) as u16;
                assert_eq!(permille(part, whole), exact, "{part} of {whole}");
            }
        }
        assert_eq!(permille(5, 0), 0);
        assert_eq!(permille(2_097_151, 1), 2047);
    }

    #[test]
    fn the_way_from_rest_to_bend_is_measured_in_either_direction() {
        assert_eq!(bend_permille(5632, 5632, 4288), 0);
        assert_eq!(bend_permille(4288, 5632, 4288), 1000);
        assert_eq!(bend_permille(4960, 5632, 4288), 500);
        assert_eq!(bend_permille(4960, 4288, 5632), 500);
        assert_eq!(bend_permille(0, 8184, 8183), 2047);
        assert_eq!(bend_permille(8184, 8183, 8182), -1000);
        assert_eq!(bend_permille(100, 4000, 4000), 0);
    }
}
