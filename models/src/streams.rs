//! Streams of random numbers: each use of a seed has its own, so that none depends on how many another one draws.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// The uses of random numbers. The numbers behind the names are part of what makes a training repeatable: a new use gets a
/// new one, and none is ever changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RandomStream {
    /// First weights and the order of windows, in recipes that train in epochs.
    Epochs,
    /// Varied windows of the recording at this place of a data set.
    Recording(usize),
    /// A varied copy of the recording at this place of a data set.
    Copy {
        /// Its place.
        recording: usize,
        /// Which copy, below 1000.
        copy: usize,
    },
    /// Which recordings of the label at this place are held out.
    HeldOut(usize),
    /// One of the networks that are fitted in steps and merged.
    Member(usize),
    /// The steps after that, which take int8's rounding into account.
    Rounding,
    /// What a model remembers of the people it was trained on.
    Memory,
    /// What is learnt of one more person.
    Adapting,
    /// Which recordings of a person held out are shown.
    Shown,
    /// The order in which recordings are joined, and the rest between them.
    Order,
    /// What the simulated wearer of this number does where no gesture is made.
    Aimless(u32),
    /// Which three recordings of each gesture a person shows (`models daily`).
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
            // As `Epochs`, which draws in other commands, or of other seeds.
            Self::ShownDaily | Self::OfWearer => 0,
        }
    }

    /// The stream's numbers for a seed, from the first on.
    pub fn of(self, seed: u64) -> ChaCha8Rng {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(self.number());
        rng
    }
}
