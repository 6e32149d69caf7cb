//! Small helper functions that interpret inputs.

use shared_proto::message::Heading;

use crate::intent::is_rest;

/// Returns a text without its numbers, which change continually.
pub(super) fn without_figures(text: &str) -> impl Iterator<Item = char> {
    text.chars().filter(|c| !c.is_ascii_digit())
}

/// Returns the command of a heading for the base; neutral and intermediate headings have the same command.
pub(super) fn command(heading: Heading) -> Heading {
    if heading == Heading::Between { Heading::Neutral } else { heading }
}

/// Returns whether the right hand rests. Without scores, this is unknown.
/// A model without a rest label cannot detect rest, so the bridge does not wait for it.
pub(super) fn rests(labels: &[String], scores: &[f32]) -> bool {
    if scores.is_empty() || scores.len() != labels.len() {
        return false;
    }
    if !labels.iter().any(|label| is_rest(label)) {
        return true;
    }
    // Of equal scores, the first label wins, as on the board. If all scores are zero, nothing was computed.
    let top = (0..scores.len()).rev().max_by(|&a, &b| scores[a].total_cmp(&scores[b]));
    top.is_some_and(|top| scores[top] > 0.0 && is_rest(&labels[top]))
}
