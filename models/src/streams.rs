//! Streams of random numbers. Each use of a seed has its own stream, which is independent of all others.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// The purposes for which random numbers are used.
/// Their numbers make a training reproducible, so a new purpose needs a new number,
/// and existing numbers never change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RandomStream {
    /// Initial weights and the order of windows, for recipes that train in epochs.
    Epochs,
    /// Variation of the windows of the recording that has this index in a data set.
    Recording(usize),
    /// A varied copy of the recording that has this index in a data set.
    Copy {
        /// Its place.
        recording: usize,
        /// Which copy, below 1000.
        copy: usize,
    },
    /// Selection of held-out recordings for the label with this index.
    HeldOut(usize),
    /// Training of one of the networks that are trained in steps and merged.
    Member(usize),
    /// The last training steps, which simulate int8 rounding.
    Rounding,
    /// Selection of the rows that a model remembers about its training people.
    Memory,
    /// Training steps of the adaptation to another person.
    Adapting,
    /// Selection of the recordings that a held-out person shows.
    Shown,
    /// The order of joined recordings, and the rest between them.
    Order,
    /// The movements of this simulated wearer, who makes no gestures.
    Aimless(u32),
    /// The three recordings of each gesture that a person shows (`models daily`).
    ShownDaily,
    /// Varied windows of a simulated wearer. The seed is the wearer's number.
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
            // This number equals that of `Epochs`, which is used in other commands or with other seeds.
            Self::ShownDaily | Self::OfWearer => 0,
        }
    }

    /// Returns the numbers of this stream for a seed, from the start.
    pub fn of(self, seed: u64) -> ChaCha8Rng {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(self.number());
        rng
    }
}
