//! Sources of a hand's bytes: a link, or a simulated board inside this program.

use shared_proto::message::Heading;

use crate::observe::Sample;

/// A key that controls a hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HandKey {
    /// An arrow.
    Arrow(Heading),
    /// `q`: a bend of the index finger.
    Faster,
    /// `z`: a bend of the middle finger.
    Slower,
    /// `1` to `6`.
    Gesture(u8),
}

/// A hand inside this program that behaves like a board on the wire.
pub trait HandSource: Send {
    /// Advances the time to `now_ms`, and appends the hand's output to `wire`.
    fn step(&mut self, now_ms: u64, wire: &mut Vec<u8>);

    /// Processes bytes from the bridge. Answers are appended to `wire`, now or in a later step.
    fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>);

    /// Reports that a key was pressed or repeated.
    fn press(&mut self, _key: HandKey, _now_ms: u64) {}

    /// Reports that a key was released.
    fn release(&mut self, _key: HandKey) {}

    /// Returns the sensor sample of the last step for observers, if there was one.
    fn sample(&self) -> Option<Sample<'_>> {
        None
    }

    /// Returns whether the hand's recording has ended. The hand is silent from then on.
    fn ended(&self) -> bool {
        false
    }
}

/// The source of a hand's data.
pub enum Source<'b> {
    /// The hand does not take part.
    Nobody,
    /// An external link, with the frames to be sent; the newest is last.
    Link(Vec<Vec<u8>>),
    /// Something here.
    Here {
        /// It.
        hand: Box<dyn HandSource + 'b>,
        /// Whether the end of the source has been reported.
        end_noted: bool,
    },
}

impl<'b> Source<'b> {
    /// A board behind a link.
    pub fn link() -> Self {
        Source::Link(Vec::new())
    }

    /// A hand inside this program.
    pub fn here(hand: impl HandSource + 'b) -> Self {
        Source::Here { hand: Box::new(hand), end_noted: false }
    }

    /// Returns whether the source is an external link.
    pub fn is_link(&self) -> bool {
        matches!(self, Source::Link(_))
    }

    /// Returns whether there is a source.
    pub fn is_there(&self) -> bool {
        !matches!(self, Source::Nobody)
    }

    pub(crate) fn press(&mut self, key: HandKey, now_ms: u64) {
        if let Source::Here { hand, .. } = self {
            hand.press(key, now_ms);
        }
    }

    pub(crate) fn release(&mut self, key: HandKey) {
        if let Source::Here { hand, .. } = self {
            hand.release(key);
        }
    }

    pub(crate) fn ended(&self) -> bool {
        match self {
            Source::Nobody => true,
            Source::Link(_) => false,
            Source::Here { hand, .. } => hand.ended(),
        }
    }
}
