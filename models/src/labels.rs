//! The standard names of gestures, and common aliases.

/// The paper's seven labels, in the order of its network's outputs.
pub const PAPER: [&str; 7] =
    ["idle", "up-down", "to-fro", "left-right", "rectangle", "rectangle-flat", "circle"];

/// Aliases in the form that [`squash`] returns, with their standard names.
const ALIASES: [(&str, &str); 26] = [
    ("idle", "idle"),
    ("still", "idle"),
    ("rest", "idle"),
    ("updown", "up-down"),
    ("vertical", "up-down"),
    ("downup", "up-down"),
    ("tofro", "to-fro"),
    ("toandfro", "to-fro"),
    ("forwardbackward", "to-fro"),
    ("forwardback", "to-fro"),
    ("backandforth", "to-fro"),
    ("backwardforward", "to-fro"),
    ("backforth", "to-fro"),
    ("leftright", "left-right"),
    ("rightleft", "left-right"),
    ("sideways", "left-right"),
    ("horizontal", "left-right"),
    ("rectangle", "rectangle"),
    ("rect", "rectangle"),
    ("rectangleflat", "rectangle-flat"),
    ("rectflat", "rectangle-flat"),
    ("flatrectangle", "rectangle-flat"),
    ("flatrect", "rectangle-flat"),
    ("circle", "circle"),
    ("circles", "circle"),
    ("round", "circle"),
];

/// Names for movement without a gesture. A model learns such movement as [`OTHER`], which has no effect.
const NO_GESTURE: [&str; 6] = ["noise", "unknown", "background", "none", "negative", "other"];

/// The label of all movement without a gesture.
pub const OTHER: &str = "other";

/// Returns whether a name other than [`OTHER`] means movement without a gesture.
///
/// ```
/// assert!(models::labels::is_no_gesture("Noise"));
/// assert!(!models::labels::is_no_gesture("other") && !models::labels::is_no_gesture("circle"));
/// ```
pub fn is_no_gesture(name: &str) -> bool {
    let squashed = squash(name);
    squashed != OTHER && NO_GESTURE.contains(&squashed.as_str())
}

/// Returns the standard names of a list of labels, each name once.
///
/// # Errors
/// Fails if two labels have the same meaning. The error names the two labels.
pub fn canonical_list(names: &[String]) -> Result<Vec<String>, String> {
    let labels: Vec<String> = names.iter().map(|name| canonical(name)).collect();
    for (at, label) in labels.iter().enumerate() {
        if let Some(first) = labels[..at].iter().position(|other| other == label) {
            return Err(format!(
                "{:?} and {:?} are both {label}; give each output a name of its own",
                names[first], names[at]
            ));
        }
    }
    Ok(labels)
}

/// Returns the name in lower case without separators, so that `Left_Right`, `left-right` and `leftright` are equal.
fn squash(name: &str) -> String {
    name.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

/// Returns the standard name of a label.
///
/// Aliases of the paper's labels are replaced with the paper's names.
/// Any other name is converted to lower case, with hyphens instead of spaces and underscores.
/// Names for movement without a gesture ([`is_no_gesture`]) are replaced with [`OTHER`].
///
/// ```
/// assert_eq!(models::labels::canonical("LeftRight"), "left-right");
/// assert_eq!(models::labels::canonical("rect"), "rectangle");
/// assert_eq!(models::labels::canonical("Big Wave"), "big-wave");
/// ```
pub fn canonical(name: &str) -> String {
    let squashed = squash(name);
    if NO_GESTURE.contains(&squashed.as_str()) {
        return OTHER.to_owned();
    }
    match ALIASES.iter().find(|(alias, _)| *alias == squashed) {
        Some((_, label)) => (*label).to_owned(),
        None => name
            .trim()
            .chars()
            .flat_map(char::to_lowercase)
            .map(|c| if c.is_whitespace() || c == '_' { '-' } else { c })
            .collect(),
    }
}

/// Words for directions and their opposites. If one word contains another, the longer word comes first.
const OPPOSITES: [(&str, &str); 9] = [
    ("counter-clockwise", "clockwise"),
    ("counterclockwise", "clockwise"),
    ("anti-clockwise", "clockwise"),
    ("anticlockwise", "clockwise"),
    ("ccw", "cw"),
    ("left", "right"),
    ("up", "down"),
    ("forward", "backward"),
    ("push", "pull"),
];

/// Returns pairs of labels whose names describe a movement and its mirror image.
/// A recipe with mirror-symmetric features can distinguish them only by habits of the wearer.
///
/// ```
/// let labels = ["swipe-left", "swipe-right", "left-right", "circle"].map(String::from);
/// assert_eq!(models::labels::mirrored(&labels), [("swipe-left", "swipe-right")]);
/// ```
pub fn mirrored(labels: &[String]) -> Vec<(&str, &str)> {
    let mut pairs = Vec::new();
    for (at, one) in labels.iter().enumerate() {
        for other in &labels[at + 1..] {
            let is_turned = |a: &str, b: &str| {
                OPPOSITES.iter().any(|(first, second)| a.contains(first) && a.replace(first, second) == b)
            };
            if is_turned(one, other) || is_turned(other, one) {
                pairs.push((one.as_str(), other.as_str()));
            }
        }
    }
    pairs
}

/// Sorts labels in the order of a network's outputs: first the paper's labels in its order, then all others by name.
pub fn sort(labels: &mut [String]) {
    labels.sort_by_key(|label| {
        let place = PAPER.iter().position(|paper| paper == label).unwrap_or(PAPER.len());
        (place, label.clone())
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_paper_label_is_its_own_canonical_name() {
        for label in PAPER {
            assert_eq!(canonical(label), label);
        }
    }

    #[test]
    fn spellings_that_people_use_are_aliases() {
        for (alias, label) in [
            ("leftright", "left-right"),
            ("Left_Right", "left-right"),
            ("updown", "up-down"),
            ("down-up", "up-down"),
            ("right_left", "left-right"),
            ("noise", "other"),
            ("Background", "other"),
            ("up down", "up-down"),
            ("tofro", "to-fro"),
            ("rect", "rectangle"),
            ("rectangleflat", "rectangle-flat"),
            ("RectangleFlat", "rectangle-flat"),
        ] {
            assert_eq!(canonical(alias), label, "{alias}");
        }
    }

    #[test]
    fn aliases_are_spelled_as_squash_leaves_them_and_lead_to_canonical_names() {
        for (alias, label) in ALIASES {
            assert_eq!(squash(alias), alias);
            assert!(PAPER.contains(&label));
        }
    }

    #[test]
    fn labels_that_differ_by_the_way_alone_are_found() {
        let names = |list: &str| list.split(',').map(canonical).collect::<Vec<_>>();
        for (list, pairs) in [
            ("circle-cw,circle-ccw,idle", vec![("circle-cw", "circle-ccw")]),
            ("clockwise,Counter Clockwise", vec![("clockwise", "counter-clockwise")]),
            ("swipe_up,swipe_down,swipe_left", vec![("swipe-up", "swipe-down")]),
            ("push,pull,wave", vec![("push", "pull")]),
            // The paper's labels are not mirror images of each other, because each of their movements goes in both directions.
            ("idle,up-down,to-fro,left-right,rectangle,rectangle-flat,circle,other", vec![]),
        ] {
            assert_eq!(mirrored(&names(list)), pairs, "{list}");
        }
    }

    #[test]
    fn names_that_mean_the_same_are_not_two_labels() {
        let names = |list: &str| list.split(',').map(String::from).collect::<Vec<_>>();
        assert_eq!(canonical_list(&names("circle,Big Wave")).unwrap(), ["circle", "big-wave"]);
        let error = canonical_list(&names("circle,wave,round")).unwrap_err();
        assert!(error.contains("\"circle\" and \"round\" are both circle"), "{error}");
    }

    #[test]
    fn labels_sort_in_the_papers_order_and_others_by_name_after_them() {
        let mut labels = ["wave", "circle", "other", "idle", "left-right"].map(String::from).to_vec();
        sort(&mut labels);
        assert_eq!(labels, ["idle", "left-right", "circle", "other", "wave"]);
    }
}
