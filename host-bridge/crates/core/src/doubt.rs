//! Explains why a hand is in doubt, and proposes remedies.

use shared_proto::message::health;

/// The meaning of each flag of a state, with advice.
const REASONS: [(u8, &str); 7] = [
    (health::SENSOR, "the accelerometer does not answer or a line is open: check its wires"),
    (
        health::FLEX,
        "a flex sensor is open, shorted or hums: check its wires and divider; what comes back within 10 s stays \
         until `host-bridge calibrate` or a restart of the board",
    ),
    (health::GRAVITY, "gravity reads impossible: `host-bridge calibrate`, and check the supply (3.3 V)"),
    (health::STUCK, "the converter repeats itself: restart the board"),
    (health::DEFAULT_CALIBRATION, "not calibrated: `host-bridge calibrate` takes a minute"),
    (health::GAP, "samples are missing from the window: look at load and sensor errors"),
    (health::MODEL, "the model cannot run on this board: send another with `host-bridge send-model`"),
];

/// Returns the reasons for the flags of a state, or nothing for a healthy hand.
pub fn reasons(flags: u8) -> Vec<&'static str> {
    let known = REASONS.iter().fold(0, |bits, (bit, _)| bits | bit);
    let mut reasons: Vec<&str> =
        REASONS.iter().filter(|(bit, _)| flags & bit != 0).map(|(_, text)| *text).collect();
    if flags & !known != 0 {
        reasons.push("for a reason that this version does not know: update host-bridge");
    }
    reasons
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_flag_has_a_reason() {
        for bit in 0..8 {
            assert_eq!(reasons(1 << bit).len(), 1, "bit {bit}");
        }
        assert_eq!(reasons(u8::MAX).len(), 8);
        assert!(reasons(0).is_empty());
    }
}
