//! Recognises the labels that are not gestures.

/// Returns whether the label is `idle` or `other`, which means that the hand rests or makes no gesture.
/// Case and punctuation do not matter: `Idle` is `idle`.
pub fn is_rest(label: &str) -> bool {
    ["idle", "other"].into_iter().any(|rest| is_same(label, rest))
}

/// Compares the letters and digits of `label` with `word`, which is in lower case. The case of `label` does not matter.
fn is_same(label: &str, word: &str) -> bool {
    // Only ASCII letters are compared, because boards have no room for tables of other letters.
    let letters = label.chars().filter(|c| !c.is_ascii() || c.is_ascii_alphanumeric());
    letters.map(|c| c.to_ascii_lowercase()).eq(word.chars())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rest_is_told_whatever_its_case_and_punctuation() {
        for label in ["idle", "Idle", "IDLE", " idle", "other", "O-ther"] {
            assert!(is_rest(label), "{label}");
        }
        for label in ["", "idler", "circle", "another", "ïdle", "idle2"] {
            assert!(!is_rest(label), "{label}");
        }
    }
}
