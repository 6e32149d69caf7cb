//! Evaluates models on unseen recordings, unknown people, joined recordings and other tempos.

pub mod events;
#[cfg(feature = "train")]
pub mod people;
pub mod score;
pub mod spectrum;
#[cfg(feature = "train")]
pub mod study;
#[cfg(feature = "train")]
pub mod tempo;
