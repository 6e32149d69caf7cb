//! What the right hand's wearer sees of the model: how near a gesture came, and what they are asked to show.

use serde::Serialize;

use super::Bridge;

/// What was nearly a gesture is shown for so long after it was over.
pub(super) const NEARLY_SHOWN_MS: u64 = 2000;

/// A gesture that was nearly one.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Nearly {
    /// The nearest gesture.
    pub label: String,
    /// Its best mean probability, 0 to 1.
    pub confidence: f32,
}

/// What the right hand's wearer is asked or told, on every surface.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Prompt {
    /// One sentence.
    pub text: String,
    /// What the key and the page's button do now; `None` = nothing.
    pub button: Option<&'static str>,
}

/// What is kept for the wearer.
#[derive(Clone, Debug, Default)]
pub(super) struct Seen {
    /// What was nearly a gesture, and until when that is shown.
    pub nearly: Option<(Nearly, u64)>,
    /// The wearer shows gestures to a model that is to learn them: none has an effect.
    pub is_shown: bool,
    /// What the wearer is asked.
    pub prompt: Option<Prompt>,
}

impl Bridge {
    /// From now on the wearer shows gestures that are to be learnt (or no longer): while that lasts, none has an effect.
    pub fn show_key(&mut self, is_shown: bool) {
        self.wearer.is_shown = is_shown;
    }

    /// Whether gestures are only shown.
    pub fn is_shown(&self) -> bool {
        self.wearer.is_shown
    }

    /// Sets what the wearer is asked.
    pub fn set_prompt(&mut self, prompt: Option<Prompt>) {
        self.wearer.prompt = prompt;
    }

    /// What the wearer is asked.
    pub fn prompt(&self) -> Option<&Prompt> {
        self.wearer.prompt.as_ref()
    }

    /// What is nearly a gesture, while it is, and for a moment after.
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
