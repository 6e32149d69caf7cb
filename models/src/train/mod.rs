//! Learns a network from a data set (windows, scaling, training, quantisation, tests, card).
//! Also adapts a model to one more person. This needs no library, so every program with the feature `adapt` contains it.
//!
//! All random values depend only on the seed and on indices in sorted lists, not on the order in which threads finish.
//! The same seed therefore gives the same files on one machine, for any number of threads.

mod adapt;
mod adaptable;
mod augment;
#[cfg(feature = "train")]
mod epochs;
mod fit;
#[cfg(feature = "train")]
mod learn;
#[cfg(all(test, feature = "train"))]
mod library;
mod memory;
#[cfg(feature = "train")]
mod net;
mod quantise;
#[cfg(feature = "train")]
mod recipe;
#[cfg(feature = "train")]
pub mod recipes;
#[cfg(feature = "train")]
mod simulated;
#[cfg(feature = "train")]
mod split;
#[cfg(feature = "train")]
mod steps;
mod trained;
mod vary;

pub use adapt::{adapt, examples_of};
pub use adaptable::{AdaptError, Adaptable};
pub use augment::Augmentation;
#[cfg(feature = "train")]
pub use epochs::Epochs;
pub use fit::Steps;
#[cfg(feature = "train")]
pub use learn::{Job, data_hash, train};
pub use memory::{Memory, MemoryError};
#[cfg(feature = "train")]
pub use recipe::{Beside, Calibration, Fitted, Learnt, Plan, Recipe, Row, Shared, Windows, scaling};
#[cfg(feature = "train")]
pub use recipes::{ALIGNED, Aligned, LOG_POWER, PAPER, PerAxis};
#[cfg(feature = "train")]
pub use split::held_out;
pub use trained::{TrainError, Trained, sha256};
