//! Measures processor time, which does not depend on other programs. It is printed and never checked.

/// Returns the processor time of this thread in ms, if the system reports it.
/// The resolution is one scheduler tick, for example 4 ms.
/// Means are therefore accurate, but single values are not.
fn cpu_ms() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).map_or(f64::NAN, |ns| ns / 1e6)
}

/// Executes `work` and returns its result and its duration in ms.
pub fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let before = cpu_ms();
    let done = work();
    (done, cpu_ms() - before)
}
