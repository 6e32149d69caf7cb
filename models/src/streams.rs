//! Streams of random numbers. Each use of a seed has its own stream, independent of all others.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// The uses of random numbers.
/// Their numbers are part of a training's reproducibility, so a new use needs a new number,
/// and existing numbers never change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RandomStream {
    /// Initial weights and the order of windows, in recipes that train in epochs.
    Epochs,
    /// Varied windows of the recording with this index in a data set.
    Recording(usize),
    /// A varied copy of the recording with this index in a data set.
    Copy {
        /// Its place.
        recording: usize,
        /// Which copy, below 1000.
        copy: usize,
    },
    /// The held-out recordings of the label with this index.
    HeldOut(usize),
    /// One of the networks that are trained in steps and merged.
    Member(usize),
    /// The later training steps, which use int8 rounding.
    Rounding,
    /// The memory of a model about its training people.
    Memory,
    /// The adaptation to another person.
    Adapting,
    /// The recordings of a held-out person that are shown.
    Shown,
    /// The order of joined recordings, and the rest between them.
    Order,
    /// The movements of this simulated wearer without gestures.
    Aimless(u32),
    /// The three recordings of each gesture that a person shows (`models daily`).
    ShownDaily,
    /// Varied windows of a simulated wearer, whose number is the seed.
    OfWearer,
}

impl RandomStream {
    const fn number(self) -> u64 {
        match self {
            Self::Epochs => 0,
            Self::Recording(index) => 1 + index as u64,
            Self::Copy { recording, copy } => 1 + (recording * 1000 + copy) as u64,
            Self::HeldOut(label) => (1 << 40) + label as u64,
            Self::Member(index) => (1 << 41) + index as u64,
            Self::Rounding => (1 << 41) + (1 << 16),
            Self::Memory => 1 << 42,
            Self::Adapting => 1 << 43,
            Self::Shown => 1 << 44,
            Self::Order => 1 << 45,
            Self::Aimless(index) => (1 << 46) + index as u64,
            // The same number as `Epochs`, which is used in other commands or with other seeds.
            Self::ShownDaily | Self::OfWearer => 0,
        }
    }

    /// Returns the stream's numbers for a seed, from the start.
    pub fn of(self, seed: u64) -> ChaCha8Rng {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(self.number());
        rng
    }
}
