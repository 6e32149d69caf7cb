//! Information for the right hand's wearer about the model: the nearest gesture, and the gesture to show.

use serde::Serialize;

use super::Bridge;

/// A near-gesture remains visible for this long after its end.
pub(super) const NEARLY_SHOWN_MS: u64 = 2000;

/// A gesture that was nearly recognised.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Nearly {
    /// The nearest gesture.
    pub label: String,
    /// The gesture's best mean probability, 0 to 1.
    pub confidence: f32,
}

/// The request or message for the right hand's wearer, on every surface.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Prompt {
    /// One sentence.
    pub text: String,
    /// The current effect of the key and the page's button; `None` means no effect.
    pub button: Option<&'static str>,
}

/// The stored information for the wearer.
#[derive(Clone, Debug, Default)]
pub(super) struct Seen {
    /// The gesture that was nearly recognised, and the time until which it is shown.
    pub nearly: Option<(Nearly, u64)>,
    /// Whether the wearer shows gestures for training. If so, no gesture has an effect.
    pub is_shown: bool,
    /// The current request to the wearer.
    pub prompt: Option<Prompt>,
}

impl Bridge {
    /// Sets whether the wearer shows gestures to be learnt. While this is true, no gesture has an effect.
    pub fn show_key(&mut self, is_shown: bool) {
        self.wearer.is_shown = is_shown;
    }

    /// Returns whether gestures are only shown, without effect.
    pub fn is_shown(&self) -> bool {
        self.wearer.is_shown
    }

    /// Sets the request to the wearer.
    pub fn set_prompt(&mut self, prompt: Option<Prompt>) {
        self.wearer.prompt = prompt;
    }

    /// Returns the request to the wearer.
    pub fn prompt(&self) -> Option<&Prompt> {
        self.wearer.prompt.as_ref()
    }

    /// Returns the gesture that is nearly recognised, now and for a moment afterwards.
    pub fn nearly(&self, now_ms: u64) -> Option<Nearly> {
        if let Some((label, confidence)) = self.almost.near() {
            let label = self.links.right.model().and_then(|model| model.labels.get(label)).cloned();
            return label.map(|label| Nearly { label, confidence });
        }
        self.wearer
            .nearly
            .as_ref()
            .filter(|(_, until_ms)| now_ms < *until_ms)
            .map(|(nearly, _)| nearly.clone())
    }
}
