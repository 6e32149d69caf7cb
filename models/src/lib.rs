//! Handles recordings, training, quantisation, TFLite files and model cards.
//!
//! Without the feature `train`, this crate is small.
//! Without `train`, it reads recordings and simulates wearers.
//! It also converts a `.tflite` file and its card to the blob.
//! With `train` (the default, used by the program `models`), it also trains networks.
//!
//! Glossary: a *recording* is one file, with samples of one person who makes one gesture.
//! A *window* is [`WINDOW`] samples at [`RATE_HZ`]. A *label* is the standard name of a gesture.
//! A *card* is a JSON file that is stored beside a model and describes the model.

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

/// Sampling rate of features and network, in Hz.
pub const RATE_HZ: f64 = 100.0;
/// Number of samples in a window of features (2 s at [`RATE_HZ`]).
pub const WINDOW: usize = 200;
/// Number of samples between the starts of two windows on the board (80 ms).
pub const HOP: usize = 8;

/// Number of networks that recipe `aligned` trains from different starts. Together they teach the network that boards run.
pub const ALIGNED_MEMBERS: usize = 8;
/// Widths of the hidden layers of each of these teachers.
pub const ALIGNED_MEMBER_HIDDEN: [usize; 2] = [20, 10];
/// Widths of the hidden layers of the network that boards run. A test measures its cost on boards.
pub const ALIGNED_HIDDEN: [usize; 2] = [60, 30];
