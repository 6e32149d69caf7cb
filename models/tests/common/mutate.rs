//! Generates damaged files and checks the limits that every reader must meet.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

mod damage;

use damage::{Rng, damage};

/// Maximum processor time for one input, checked only with `BIMANUAL_FULL=1`.
/// Processor time does not depend on the load of the machine.
const LONGEST: Duration = Duration::from_secs(2);
/// Maximum memory of the whole program, in KiB.
const MEMORY_KIB: u64 = 500 * 1024;

/// Number of inputs per reader: small by default, a million with `BIMANUAL_FULL=1`.
pub fn count(few: u64) -> u64 {
    if is_full() { 1_000_000 } else { few }
}

fn is_full() -> bool {
    std::env::var_os("BIMANUAL_FULL").is_some()
}

/// Calls `read` with damaged files. `read` returns whether it accepted the input, and panics if a check fails.
pub fn fuzz(name: &str, seeds: &[Vec<u8>], inputs: u64, read: impl Fn(&[u8]) -> bool + Sync) {
    for seed in seeds {
        assert!(read(seed), "{name}: what is whole is read");
    }
    let (next, taken, longest_us) = (AtomicU64::new(0), AtomicU64::new(0), AtomicU64::new(0));
    let work = || {
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= inputs {
                return;
            }
            // The number of an input determines its content.
            let mut rng = Rng(number.wrapping_mul(0x2545_F491_4F6C_DD1D) ^ name.len() as u64);
            let mut bytes = seeds[rng.below(seeds.len())].clone();
            let donor = &seeds[rng.below(seeds.len())];
            for _ in 0..1 + rng.below(6) {
                damage(&mut rng, &mut bytes, donor);
            }
            let began = work_done();
            let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| read(&bytes)));
            let took = work_done().saturating_sub(began);
            match result {
                Ok(ok) => taken.fetch_add(ok.into(), Ordering::Relaxed),
                Err(_) => panic!("{name}: input {number} panics: {}", keep(name, number, &bytes)),
            };
            longest_us.fetch_max(took.as_micros() as u64, Ordering::Relaxed);
            if is_full() && took > LONGEST {
                panic!("{name}: input {number} took {took:?}: {}", keep(name, number, &bytes));
            }
        }
    };
    let threads = if is_full() { 2 } else { 1 };
    std::thread::scope(|scope| {
        let all: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        all.into_iter().for_each(|thread| thread.join().expect("said above"));
    });
    let taken = taken.into_inner();
    println!(
        "{name}: {inputs} inputs, {taken} read, {} refused, the longest {:.1} ms, memory at most {} MB",
        inputs - taken,
        longest_us.into_inner() as f64 / 1000.0,
        memory_kib().unwrap_or_default() / 1024
    );
    // If too few inputs were accepted, the deeper parts of the reader were never tested.
    assert!(taken > inputs / 1000, "{name}: {taken} of {inputs} are read");
    if let Some(kib) = memory_kib() {
        assert!(kib < MEMORY_KIB, "{name}: {kib} KiB");
    }
}

/// Processor time of this thread, or the time since the start if the system does not report it.
fn work_done() -> Duration {
    static START: std::sync::LazyLock<Instant> = std::sync::LazyLock::new(Instant::now);
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let ns = told.and_then(|text| text.split_whitespace().next()?.parse().ok());
    ns.map_or_else(|| START.elapsed(), Duration::from_nanos)
}

/// Peak memory use of this program, if the system reports it.
fn memory_kib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

/// Writes an input to a file for later analysis, and returns the path.
fn keep(name: &str, number: u64, bytes: &[u8]) -> String {
    let name: String = name.chars().map(|c| if c.is_alphanumeric() { c } else { '-' }).collect();
    let file = std::env::temp_dir().join(format!("bimanual-fuzz-{name}-{number}"));
    match std::fs::write(&file, bytes) {
        Ok(()) => file.display().to_string(),
        Err(error) => error.to_string(),
    }
}
