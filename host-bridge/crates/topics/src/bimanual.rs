//! Our own messages, of the package `bimanual_msgs`.

use crate::message::{Header, Time};
use crate::schema::messages;

messages! {
    /// Bytes of one hand's link.
    "bimanual_msgs/Bytes" Bytes {
        /// Time of day.
        stamp: Time,
        /// When the bridge handled them, on its own clock.
        time_ms: u64,
        /// The bytes.
        data: Vec<u8>,
    }

    /// A key of the operator.
    "bimanual_msgs/Operated" Operated {
        /// Time of day.
        stamp: Time,
        /// When, on the bridge's clock.
        time_ms: u64,
        /// 0 = stop, 1 = release, 2 = end the arm's motion, 3 = begin to show gestures, 4 = end that, 5 = the clutch.
        key: u8,
    }

    /// The robot itself refuses to move, or does not any more.
    "bimanual_msgs/Refused" Refused {
        /// Time of day.
        stamp: Time,
        /// When, on the bridge's clock.
        time_ms: u64,
        /// Why; empty = it does not refuse any more.
        reason: String,
    }

    /// Steps since the message before this one.
    "bimanual_msgs/Turns" Turns {
        /// In their order.
        turns: Vec<Turn>,
    }

    /// One step.
    "bimanual_msgs/Turn" Turn {
        /// 0 = the bridge decided at this time, 1 = the robot moved on by this long, 2 = a motion that had been planned began.
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
        /// 0 = straight, 1000 = as far as calibrated.
        bends_permille: [i16; 2],
    }

    /// One reading of the right hand's IMU.
    "bimanual_msgs/RightSample" RightSample {
        /// Time of day.
        header: Header,
        /// Accelerometer (m/s2), gyroscope (deg/s), magnetometer (uT), as far as the sensor has them.
        values: Vec<f32>,
    }

    /// What the hands say.
    "bimanual_msgs/Hands" Hands {
        /// Time of day.
        header: Header,
        /// State of the dead-man; if the robot refuses to move, or the session is restricted, the reason follows.
        safety: String,
        /// Left hand.
        pitch_rad: f64,
        /// Left hand.
        roll_rad: f64,
        /// Of the left hand.
        heading: String,
        /// Both fingers are bent: stop.
        both_fingers: bool,
        /// What the right hand's model knows.
        labels: Vec<String>,
        /// One per label.
        scores: Vec<f32>,
        /// Speed limit.
        cap_m_s: f64,
        /// Turning limit.
        cap_rad_s: f64,
    }

    /// Something happened.
    "bimanual_msgs/Event" Event {
        /// Time of day.
        header: Header,
        /// When, on the bridge's clock.
        time_ms: u64,
        /// As people read it.
        text: String,
        /// With all its values.
        json: String,
    }

    /// What a hand asks for, and what follows.
    "bimanual_msgs/Intent" Intent {
        /// Time of day.
        header: Header,
        /// left or right.
        hand: String,
        /// Heading or label.
        name: String,
        /// What follows.
        outcome: String,
        /// 0 to 1.
        confidence: f32,
        /// How old the sample was.
        age_ms: u64,
        /// Forward, if it is about speed.
        linear_m_s: f64,
        /// To the left, if it is about speed.
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
        /// Time of day.
        header: Header,
        /// When, on the bridge's clock.
        time_ms: u64,
        /// begin, end, again, good or bad.
        mark: String,
        /// gesture, key or page.
        by: String,
        /// What follows, as people read it.
        text: String,
    }

    /// Messages before this one are missing.
    "bimanual_msgs/Lost" Lost {
        /// Time of day.
        header: Header,
        /// How many.
        messages: u64,
    }
}
