//! Small judgements of what was heard.

use shared_proto::message::Heading;

use crate::intent::is_rest;

/// A text without its figures, which change all the time.
pub(super) fn without_figures(text: &str) -> impl Iterator<Item = char> {
    text.chars().filter(|c| !c.is_ascii_digit())
}

/// What a heading asks of the base; neutral and between ask the same.
pub(super) fn command(heading: Heading) -> Heading {
    if heading == Heading::Between { Heading::Neutral } else { heading }
}

/// Does the right hand rest? Without scores nobody knows; a model without a resting class cannot tell,
/// and is then not waited for.
pub(super) fn rests(labels: &[String], scores: &[f32]) -> bool {
    if scores.is_empty() || scores.len() != labels.len() {
        return false;
    }
    if !labels.iter().any(|label| is_rest(label)) {
        return true;
    }
    // Of equal scores the first label wins, as on the board. All zero means that nothing was computed.
    let top = (0..scores.len()).rev().max_by(|&a, &b| scores[a].total_cmp(&scores[b]));
    top.is_some_and(|top| scores[top] > 0.0 && is_rest(&labels[top]))
}
