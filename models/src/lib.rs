//! Recordings, training, quantisation, TFLite files and model cards.
//!
//! Without the feature `train` this crate is small: reading recordings, simulated wearers and
//! turning a `.tflite` file with its card into the blob that boards and bridge run. With `train`
//! (the default, used by the tool `models`) it also learns networks.
//!
//! Glossary: a *recording* is one file of samples of one person making one gesture; a *window* is
//! [`WINDOW`] samples at [`RATE_HZ`]; a *label* is a gesture's canonical name; a *card* is the JSON
//! beside a model that says where it comes from.

pub mod adc;
pub mod blob;
pub mod bundled;
pub mod card;
#[cfg(feature = "adapt")]
pub mod daily;
pub mod dataset;
#[cfg(feature = "train")]
pub mod edge_impulse;
pub mod errors;
pub mod evaluate;
pub mod labels;
pub mod recording;
#[cfg(feature = "train")]
pub mod report;
pub mod say;
pub mod sheet;
pub mod streams;
pub mod synth;
pub mod tflite;
#[cfg(feature = "adapt")]
pub mod train;
pub mod windows;

/// Sampling rate of the features and the network, in Hz.
pub const RATE_HZ: f64 = 100.0;
/// Samples in one window of features (2 s at [`RATE_HZ`]).
pub const WINDOW: usize = 200;
/// Samples from one window to the next on the board (80 ms).
pub const HOP: usize = 8;

/// How many networks the recipe `aligned` fits from different starts and merges into one.
pub const ALIGNED_MEMBERS: usize = 4;
/// Widths of the hidden layers of each of them.
pub const ALIGNED_MEMBER_HIDDEN: [usize; 2] = [20, 10];
/// Widths of the hidden layers of the merged network, which boards run; a test measures its cost there.
pub const ALIGNED_HIDDEN: [usize; 2] =
    [ALIGNED_MEMBERS * ALIGNED_MEMBER_HIDDEN[0], ALIGNED_MEMBERS * ALIGNED_MEMBER_HIDDEN[1]];
