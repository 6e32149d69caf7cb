//! Errors for people.

/// Formats an error with its causes. A cause that an error already mentions is not printed again.
///
/// ```
/// let error = models::recording::Recording::read("no/such.csv".as_ref()).unwrap_err();
/// let text = models::errors::in_full(&error);
/// assert_eq!(text.matches("No such file").count(), 1, "{text}");
/// ```
pub fn in_full(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let more = error.to_string();
        if !text.contains(&more) {
            text = format!("{text}: {more}");
        }
        cause = error.source();
    }
    text
}
