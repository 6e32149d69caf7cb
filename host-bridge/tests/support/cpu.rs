//! Processor time, which does not grow when others keep the machine busy. For printing; nothing asserts it.

/// Processor time of this thread in ms, if the system reports it: in steps of the scheduler's tick (4 ms, say), so
/// that means are exact and single values are not.
fn cpu_ms() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).map_or(f64::NAN, |ns| ns / 1e6)
}

/// Does something; returns how long that took in ms.
pub fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let before = cpu_ms();
    let done = work();
    (done, cpu_ms() - before)
}
