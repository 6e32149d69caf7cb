//! How well a model does: recordings it has never seen, people it has never met, one recording after the other played
//! through the right hand, other tempos.

pub mod events;
#[cfg(feature = "train")]
pub mod people;
pub mod score;
#[cfg(feature = "train")]
pub mod study;
#[cfg(feature = "train")]
pub mod tempo;
