//! Where a hand's bytes come from: a link, or something in this program that behaves like a board.

use shared_proto::message::Heading;

use crate::observe::Sample;

/// A key that means something to a hand.
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

/// A hand inside this program: on the wire it looks like a board.
pub trait HandSource: Send {
    /// Lets the time become `now_ms`; what the hand sent meanwhile is appended to `wire`.
    fn step(&mut self, now_ms: u64, wire: &mut Vec<u8>);

    /// Takes bytes from the bridge. Answers are appended to `wire`, now or in a later step.
    fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>);

    /// A key was pressed or repeated.
    fn press(&mut self, _key: HandKey, _now_ms: u64) {}

    /// A key is up.
    fn release(&mut self, _key: HandKey) {}

    /// The reading of its sensors that it took in the last step, if any, for observers.
    fn sample(&self) -> Option<Sample<'_>> {
        None
    }

    /// The recording that it plays is over; it is silent from now on.
    fn ended(&self) -> bool {
        false
    }
}

/// What plays a hand.
pub enum Source<'b> {
    /// Nothing: the hand takes no part.
    Nobody,
    /// A link outside; what waits to be sent, newest last.
    Link(Vec<Vec<u8>>),
    /// Something here.
    Here {
        /// It.
        hand: Box<dyn HandSource + 'b>,
        /// Its end has been reported.
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

    /// Whether it is behind a link.
    pub fn is_link(&self) -> bool {
        matches!(self, Source::Link(_))
    }

    /// Whether there is any.
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
