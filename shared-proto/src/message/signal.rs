//! The signals of a vibration motor.

use postcard::experimental::max_size::MaxSize;
use serde::{Deserialize, Serialize};

open_list! {
    /// What the wearer of a right hand shall feel.
    Signal {
        /// Nothing yet; from now on the board itself signals [`Signal::LinkLost`] if the laptop falls silent.
        Ready = 0,
        /// A gesture counts.
        Accepted = 1,
        /// A gesture does nothing.
        Refused = 2,
        /// The robot was stopped.
        Stopped = 3,
        /// A hand's link is lost.
        LinkLost = 4,
    }
}
