//! Whether times that were measured by the wall clock can be judged.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

const SLEEP: Duration = Duration::from_millis(5);
/// Sleeps between two looks at what the processors did.
const SLEEPS_PER_LOOK: u32 = 20;

/// What a busy machine does to everybody's time says nothing about the program's own delays.
#[derive(Clone)]
pub struct Lateness(Arc<Mutex<Seen>>);

#[derive(Clone, Default)]
struct Seen {
    /// How late this machine wakes a thread that slept, each time.
    late_ms: Vec<f64>,
    /// The share of all processors that work of ordinary priority took, in each tenth of a second.
    taken: Vec<f64>,
}

impl Lateness {
    /// Begins to look.
    pub fn watch() -> Self {
        let seen = Arc::new(Mutex::new(Seen::default()));
        // Ends when nobody asks any more.
        let looks = Arc::downgrade(&seen);
        std::thread::spawn(move || {
            let mut before = ordinary_and_all();
            for sleeps in 1_u32.. {
                let start = Instant::now();
                std::thread::sleep(SLEEP);
                let late = start.elapsed().saturating_sub(SLEEP).as_secs_f64() * 1000.0;
                let Some(seen) = looks.upgrade() else { return };
                let mut seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
                seen.late_ms.push(late);
                if sleeps.is_multiple_of(SLEEPS_PER_LOOK) {
                    let now = ordinary_and_all();
                    if let (Some(before), Some(now)) = (before, now) {
                        seen.taken.push((now.0 - before.0) / (now.1 - before.1).max(1.0));
                    }
                    before = now;
                }
            }
        });
        Lateness(seen)
    }

    /// Whether times measured meanwhile can be judged, of what takes the processors itself: nine sleeps of ten ended
    /// within 2 ms.
    pub fn woke_in_time(&self) -> bool {
        let late_ms = mostly(self.seen().late_ms);
        let in_time = late_ms <= 2.0;
        if !in_time {
            println!("NOT JUDGED: this machine is busy and wakes a thread {late_ms:.1} ms late");
        }
        in_time
    }

    /// Whether times measured meanwhile can be judged: as [`Self::woke_in_time`], and in nine tenths of a second of ten
    /// work of ordinary priority left something of the processors. (A thread that hardly works is woken in time on a
    /// full machine, too.)
    pub fn was_quiet(&self) -> bool {
        let taken = mostly(self.seen().taken);
        let leaves = taken <= 0.9;
        if !leaves {
            println!("NOT JUDGED: {:.0} % of this machine's processors are taken", taken * 100.0);
        }
        self.woke_in_time() && leaves
    }

    fn seen(&self) -> Seen {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// What nine of ten do not exceed; 0 of none.
fn mostly(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() * 9 / 10).copied().unwrap_or(0.0)
}

/// Ticks that the processors spent on work of ordinary priority, and all ticks, since the machine started; `None`
/// where the system does not say.
fn ordinary_and_all() -> Option<(f64, f64)> {
    let text = std::fs::read_to_string("/proc/stat").ok()?;
    let ticks: Vec<f64> = text.lines().next()?.split_whitespace().skip(1).flat_map(str::parse).collect();
    // user, nice, system, idle, iowait, irq, softirq, steal: what is nice, idle or waits would have given way. Steal
    // is another machine's work, and does not give way.
    let [user, _nice, system, _idle, _iowait, irq, softirq, steal] = *ticks.first_chunk()?;
    Some((user + system + irq + softirq + steal, ticks[..8].iter().sum()))
}
