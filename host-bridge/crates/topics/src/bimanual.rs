//! Our own messages, of the package `bimanual_msgs`.

use crate::message::{Header, Time};
use crate::schema::messages;

messages! {
    /// Bytes of one hand's link.
    "bimanual_msgs/Bytes" Bytes {
        /// Time of day.
        stamp: Time,
        /// Time at which the bridge processed the bytes, on the bridge's own clock.
        time_ms: u64,
        /// The bytes.
        data: Vec<u8>,
    }

    /// A key of the operator.
    "bimanual_msgs/Operated" Operated {
        /// Time of day.
        stamp: Time,
        /// Time on the bridge's clock.
        time_ms: u64,
        /// 0 = stop, 1 = release, 2 = end the arm's motion, 3 = begin to show gestures,
        /// 4 = end showing, 5 = the clutch.
        key: u8,
    }

    /// The robot itself begins to refuse motion, or no longer refuses it.
    "bimanual_msgs/Refused" Refused {
        /// Time of day.
        stamp: Time,
        /// Time on the bridge's clock.
        time_ms: u64,
        /// The reason; empty if the robot no longer refuses.
        reason: String,
    }

    /// The steps since the previous message of this kind.
    "bimanual_msgs/Turns" Turns {
        /// In their order.
        turns: Vec<Turn>,
    }

    /// One step.
    "bimanual_msgs/Turn" Turn {
        /// 0 = the bridge decided at this time, 1 = the robot moved on by this long,
        /// 2 = a planned motion began.
        kind: u8,
        /// Time or duration in ms.
        ms: u64,
    }

    /// One reading of the left hand's converter.
    "bimanual_msgs/LeftSample" LeftSample {
        /// Time of day.
        header: Header,
        /// Conversions (10 bits): x, y, z, index, middle.
        counts: [u16; 5],
        /// 0 = straight, 1000 = bent as in the calibration.
        bends_permille: [i16; 2],
    }

    /// One reading of the right hand's IMU.
    "bimanual_msgs/RightSample" RightSample {
        /// Time of day.
        header: Header,
        /// Accelerometer (m/s2), then gyroscope (deg/s) and magnetometer (uT) if the sensor has these parts.
        values: Vec<f32>,
    }

    /// The state of both hands.
    "bimanual_msgs/Hands" Hands {
        /// Time of day.
        header: Header,
        /// State of the dead-man. The reason follows if the robot refuses to move,
        /// or if the session is restricted.
        safety: String,
        /// Pitch of the left hand.
        pitch_rad: f64,
        /// Roll of the left hand.
        roll_rad: f64,
        /// Heading of the left hand.
        heading: String,
        /// Whether both fingers are bent, which stops the robot.
        both_fingers: bool,
        /// Labels of the right hand's model.
        labels: Vec<String>,
        /// One score per label.
        scores: Vec<f32>,
        /// Maximum speed of the base.
        cap_m_s: f64,
        /// Maximum turning speed of the base.
        cap_rad_s: f64,
    }

    /// Something happened.
    "bimanual_msgs/Event" Event {
        /// Time of day.
        header: Header,
        /// Time on the bridge's clock.
        time_ms: u64,
        /// The event as a text for users.
        text: String,
        /// The event with all its values.
        json: String,
    }

    /// A command of a hand, and its effect.
    "bimanual_msgs/Intent" Intent {
        /// Time of day.
        header: Header,
        /// left or right.
        hand: String,
        /// Heading or label.
        name: String,
        /// The effect of the command.
        outcome: String,
        /// 0 to 1.
        confidence: f32,
        /// Age of the hand's sample.
        age_ms: u64,
        /// Forward speed, if the command is a speed.
        linear_m_s: f64,
        /// Turning speed to the left, if the command is a speed.
        angular_rad_s: f64,
    }

    /// Base and arm were halted, or the operator's stop was released.
    "bimanual_msgs/Stop" Stop {
        /// Time of day.
        header: Header,
        /// False = released.
        halted: bool,
        /// Why.
        reason: String,
    }

    /// The operator marked an episode.
    "bimanual_msgs/Mark" Mark {
        /// Time on the bridge's clock.
        header: Header,
        /// When, on the bridge's clock.
        time_ms: u64,
        /// begin, end, again, good or bad.
        mark: String,
        /// gesture, key or page.
        by: String,
        /// The effect of the mark, as a text for users.
        text: String,
    }

    /// Messages before this one are missing.
    "bimanual_msgs/Lost" Lost {
        /// Time of day.
        header: Header,
        /// Number of missing messages.
        messages: u64,
    }
}
