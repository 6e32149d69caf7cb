//! The signals that a vibration motor plays.

use postcard::experimental::max_size::MaxSize;
use serde::{Deserialize, Serialize};

open_list! {
    /// Signals for the wearer of a right hand.
    Signal {
        /// Plays nothing. Afterwards, the board plays [`Signal::LinkLost`] by itself if the laptop is silent.
        Ready = 0,
        /// A gesture was accepted.
        Accepted = 1,
        /// A gesture had no effect.
        Refused = 2,
        /// The robot was stopped.
        Stopped = 3,
        /// A hand's link is lost.
        LinkLost = 4,
    }
}
