//! The complete right hand. Samples go in, and one result per hop comes out. The board and the laptop run the same code.

pub mod aligned;
pub mod decision;
pub mod features;
pub mod fft;
pub mod kind;
pub mod moments;
pub mod movement;
pub mod network;
pub mod powers;
pub mod sliding;
pub mod slow;
pub mod softmax;

use crate::right::aligned::AlignedWindow;
use crate::right::decision::{DecisionConfig, GestureDecision, GestureEvent};
use crate::right::features::{FeatureWindow, HOP, WINDOW};
use crate::right::kind::FeatureKind;
use crate::right::movement::{MovementConfig, MovementDecision};
use crate::right::network::{MAX_LABELS, Model};
use crate::right::slow::SlowWindow;
use core::borrow::BorrowMut;
use core::fmt;

/// The reason why a model cannot run on a hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ModelMismatch {
    /// The model needs more values per sample than the board has, or different values.
    Axes {
        /// Axes of the model.
        model: usize,
        /// Axes of the hand.
        hand: usize,
    },
    /// The model needs windows or hops that differ from [`WINDOW`] and [`HOP`].
    Window {
        /// Samples per window of the model.
        window: u16,
        /// Samples per hop of the model.
        hop: u16,
    },
}

impl fmt::Display for ModelMismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Axes { model, hand } => {
                write!(f, "the model needs {model} axes and the samples have {hand}")
            }
            Self::Window { window, hop } => write!(
                f,
                "the model needs windows of {window} samples every {hop}; this program makes {WINDOW} every {HOP}"
            ),
        }
    }
}

impl core::error::Error for ModelMismatch {}

/// State of the right hand after one hop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RightOutput {
    /// Time of the window's newest sample, as given to [`RightHand::push`].
    pub window_end_ms: u32,
    /// Whether the window is full.
    /// After a start or a gap, the window is not full, and the scores are from before the gap.
    pub full: bool,
    /// Whether the window or the slow window contains values that replaced NaN.
    pub replaced: bool,
    /// Number of gestures that were performed since the start. The number wraps.
    pub events: u8,
    /// Whether this hop caused an event.
    pub is_event: bool,
    /// Label of the last event; 255 before the first event.
    pub label: u8,
    /// Confidence of the last event, 0 to 255.
    pub confidence: u8,
    /// `window_end_ms` of the hop that triggered the last event.
    pub event_window_end_ms: u32,
    /// Int8 scores, of which the first `label_count` are valid: (score + 128) / 256 is the probability.
    pub scores: [i8; MAX_LABELS],
    /// Number of labels that the model has.
    pub label_count: u8,
}

impl RightOutput {
    /// One score per label.
    pub fn scores(&self) -> &[i8] {
        &self.scores[..usize::from(self.label_count).min(MAX_LABELS)]
    }

    /// The scores as bytes for the wire.
    pub fn score_bytes(&self) -> [u8; MAX_LABELS] {
        self.scores.map(|score| score as u8)
    }
}

/// All signal processing of the right hand for samples with `A` axes.
/// The model may read fewer axes ([`FeatureKind::runs_on`]).
///
/// `W` holds the windows: their value, or a reference to them.
/// A board lends static windows, because a value of their size would be built and moved on its stack.
#[derive(Clone, Debug)]
pub struct RightHand<'m, const A: usize, W = Windows<A>> {
    model: Model<'m>,
    windows: W,
    decision: Decision,
    output: RightOutput,
    in_hop: usize,
}

/// The stage before the network, which the model's recipe determines.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "one per board, and no heap to put it on")]
pub enum Windows<const A: usize> {
    /// Recipes 1 and 2.
    PerAxis(FeatureWindow<A>),
    /// Recipe 3.
    Aligned(AlignedWindow<A>, SlowWindow<A>),
}

/// The stage after the network.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "one per board, and no heap to put it on")]
enum Decision {
    /// Recipes 1 and 2.
    PerAxis(GestureDecision),
    /// Recipe 3.
    Aligned(MovementDecision),
}

impl<const A: usize> Windows<A> {
    /// Empty windows for any recipe. All their bytes are zero, so that static windows take no flash.
    pub const fn new() -> Self {
        Self::PerAxis(FeatureWindow::new())
    }

    /// Adds a sample. Returns true if this completes new features.
    fn push(&mut self, sample: &[f32; A]) -> bool {
        match self {
            Self::PerAxis(window) => window.push(sample),
            Self::Aligned(window, slow) => {
                slow.push(sample);
                window.push(sample)
            }
        }
    }

    /// Runs the network and the decision on the newest features.
    fn decide(
        &mut self,
        model: &Model<'_>,
        decision: &mut Decision,
        scores: &mut [i8],
    ) -> Option<GestureEvent> {
        // `RightHand::with_windows` has compared the lengths, so classifying cannot fail.
        // If it did, the scores would remain unchanged.
        match (self, decision) {
            (Self::PerAxis(window), Decision::PerAxis(decision)) => {
                // If the hand has more axes than the model, the model reads only the first axes.
                let axes = model.info().axes.min(A);
                let _ = model.classify(&window.features()[..axes], scores);
                decision.step(scores)
            }
            (Self::Aligned(window, slow), Decision::Aligned(decision)) => {
                let _ = model.classify_features(window.features(), scores);
                let mut slow_scores = [i8::MIN; MAX_LABELS];
                let slow_scores = slow.new_features().map(|features| {
                    let _ = model.classify_features(features, &mut slow_scores[..scores.len()]);
                    &slow_scores[..scores.len()]
                });
                decision.step(scores, slow_scores, window.movement())
            }
            // `RightHand::with_windows` has chosen both for the same recipe.
            _ => None,
        }
    }

    fn reset(&mut self) {
        match self {
            Self::PerAxis(window) => window.reset(),
            Self::Aligned(window, slow) => {
                window.reset();
                slow.reset();
            }
        }
    }

    fn replaced(&self) -> u32 {
        match self {
            Self::PerAxis(window) => window.replaced(),
            Self::Aligned(window, _) => window.replaced(),
        }
    }

    fn is_tainted(&self) -> bool {
        match self {
            Self::PerAxis(window) => window.is_tainted(),
            Self::Aligned(window, slow) => window.is_tainted() || slow.is_tainted(),
        }
    }
}

impl<const A: usize> Default for Windows<A> {
    fn default() -> Self {
        Self::new()
    }
}

impl Decision {
    fn reset(&mut self) {
        match self {
            Self::PerAxis(decision) => decision.reset(),
            Self::Aligned(decision) => decision.reset(),
        }
    }
}

impl<'m, const A: usize> RightHand<'m, A> {
    /// Creates a hand that runs the given model, with windows of its own.
    ///
    /// `config` applies to models of recipes 1 and 2.
    /// Models of recipe 3 use their own decision ([`crate::right::movement`]) with its default values.
    ///
    /// # Errors
    /// Fails if the model is for other samples or windows.
    pub fn new(model: Model<'m>, config: DecisionConfig) -> Result<Self, ModelMismatch> {
        Self::with_windows(model, config, Windows::new())
    }
}

impl<'m, const A: usize, W: BorrowMut<Windows<A>>> RightHand<'m, A, W> {
    /// Like [`RightHand::new`], but with the given windows, which must be new.
    ///
    /// # Errors
    /// Fails if the model is for other samples or windows.
    pub fn with_windows(model: Model<'m>, config: DecisionConfig, windows: W) -> Result<Self, ModelMismatch> {
        let info = model.info();
        if !info.recipe.runs_on(info.axes, A) {
            return Err(ModelMismatch::Axes { model: info.axes, hand: A });
        }
        if (usize::from(info.window), usize::from(info.hop)) != (WINDOW, HOP) {
            return Err(ModelMismatch::Window { window: info.window, hop: info.hop });
        }
        let output = RightOutput {
            window_end_ms: 0,
            full: false,
            replaced: false,
            events: 0,
            is_event: false,
            label: 255,
            confidence: 0,
            event_window_end_ms: 0,
            scores: [i8::MIN; MAX_LABELS],
            label_count: info.label_count as u8,
        };
        let decision = match info.recipe {
            FeatureKind::Raw | FeatureKind::LogPower => {
                Decision::PerAxis(GestureDecision::new(info.labels(), config))
            }
            FeatureKind::Aligned => {
                Decision::Aligned(MovementDecision::new(info.labels(), MovementConfig::for_axes(A)))
            }
        };
        let mut hand = Self { model, windows, decision, output, in_hop: 0 };
        if matches!(hand.decision, Decision::Aligned(_)) {
            *hand.windows.borrow_mut() = Windows::Aligned(AlignedWindow::new(), SlowWindow::new());
        }
        Ok(hand)
    }

    /// Adds a sample at the model's rate (in m/s², deg/s, µT), with its time.
    /// Returns the state once per hop, even before the window is full.
    pub fn push(&mut self, sample: &[f32; A], time_ms: u32) -> Option<&RightOutput> {
        let windows = self.windows.borrow_mut();
        let ready = windows.push(sample);
        self.in_hop += 1;
        if self.in_hop < HOP {
            return None;
        }
        self.in_hop = 0;
        let output = &mut self.output;
        output.window_end_ms = time_ms;
        output.full = ready;
        output.replaced = windows.is_tainted();
        output.is_event = false;
        if ready {
            let scores = &mut output.scores[..self.model.info().label_count];
            if let Some(event) = windows.decide(&self.model, &mut self.decision, scores) {
                output.events = output.events.wrapping_add(1);
                output.is_event = true;
                output.label = event.label;
                output.confidence = event.confidence;
                output.event_window_end_ms = time_ms;
            }
        }
        Some(output)
    }

    /// Reports missing samples. Window and decision start again; past events and their counter remain.
    pub fn gap(&mut self) {
        self.windows.borrow_mut().reset();
        self.decision.reset();
        self.in_hop = 0;
        self.output.full = false;
        self.output.is_event = false;
    }

    /// The state after the last hop.
    pub fn output(&self) -> &RightOutput {
        &self.output
    }

    /// The active model.
    pub fn model(&self) -> &Model<'m> {
        &self.model
    }

    /// Number of NaN values since start or the last gap.
    pub fn replaced(&self) -> u32 {
        self.windows.borrow().replaced()
    }
}
