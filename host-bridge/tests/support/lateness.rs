//! Determines whether times measured with the wall clock are meaningful.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

const SLEEP: Duration = Duration::from_millis(5);
/// Number of sleeps between two measurements of the processor load.
const SLEEPS_PER_LOOK: u32 = 20;

/// Measures the load of the machine, because a busy machine delays every program.
#[derive(Clone)]
pub struct Lateness(Arc<Mutex<Seen>>);

#[derive(Clone, Default)]
struct Seen {
    /// Delays with which this machine woke a sleeping thread.
    late_ms: Vec<f64>,
    /// Share of all processors used at normal priority, in each tenth of a second.
    taken: Vec<f64>,
    /// Share of all processors that other programs used, in each tenth of a second.
    others: Vec<f64>,
}

impl Lateness {
    /// Starts the measurement.
    pub fn watch() -> Self {
        let seen = Arc::new(Mutex::new(Seen::default()));
        // The thread ends when this is dropped.
        let looks = Arc::downgrade(&seen);
        std::thread::spawn(move || {
            let mut before = Ticks::now();
            for sleeps in 1_u32.. {
                let start = Instant::now();
                std::thread::sleep(SLEEP);
                let late = start.elapsed().saturating_sub(SLEEP).as_secs_f64() * 1000.0;
                let Some(seen) = looks.upgrade() else { return };
                let mut seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
                seen.late_ms.push(late);
                if sleeps.is_multiple_of(SLEEPS_PER_LOOK) {
                    let now = Ticks::now();
                    if let (Some(before), Some(now)) = (before, now) {
                        let all = (now.all - before.all).max(1.0);
                        let (taken, ours) = (now.ordinary - before.ordinary, now.ours - before.ours);
                        seen.taken.push(taken / all);
                        seen.others.push((taken - ours) / all);
                    }
                    before = now;
                }
            }
        });
        Lateness(seen)
    }

    /// Returns whether times measured since the start can be judged in a test that itself loads the processors.
    /// Nine of ten sleeps must have ended within 2 ms,
    /// and other programs must have left half of the processors.
    pub fn had_room(&self) -> bool {
        at_most(0.5, self.seen().others, "others take") && self.woke_in_time()
    }

    fn woke_in_time(&self) -> bool {
        let late_ms = mostly(self.seen().late_ms);
        let in_time = late_ms <= 2.0;
        if !in_time {
            println!("NOT JUDGED: this machine is busy and wakes a thread {late_ms:.1} ms late");
        }
        in_time
    }

    /// Returns whether times measured since the start can be judged.
    /// Nine of ten sleeps must have ended within 2 ms.
    /// In 90 % of the intervals of 0.1 s, work at normal priority must have left some processor time.
    /// The second condition is necessary,
    /// because a mostly idle thread wakes in time even on a fully loaded machine.
    pub fn was_quiet(&self) -> bool {
        at_most(0.9, self.seen().taken, "work of ordinary priority takes") && self.woke_in_time()
    }

    fn seen(&self) -> Seen {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Returns whether at least nine of ten shares are within the limit.
fn at_most(limit: f64, shares: Vec<f64>, who: &str) -> bool {
    let share = mostly(shares);
    if share > limit {
        println!("NOT JUDGED: {who} {:.0} % of this machine's processors", share * 100.0);
    }
    share <= limit
}

/// Returns the 90th percentile, or 0 if there are no values.
fn mostly(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() * 9 / 10).copied().unwrap_or(0.0)
}

/// Processor usage since the start of the machine, in ticks.
#[derive(Clone, Copy)]
struct Ticks {
    /// Processor usage at normal priority.
    ordinary: f64,
    /// The part of this usage that belongs to the test and its programs.
    ours: f64,
    all: f64,
}

impl Ticks {
    /// Returns `None` if the system does not report it.
    fn now() -> Option<Self> {
        let text = std::fs::read_to_string("/proc/stat").ok()?;
        let ticks: Vec<f64> = text.lines().next()?.split_whitespace().skip(1).flat_map(str::parse).collect();
        // The fields are user, nice, system, idle, iowait, irq, softirq and steal.
        // Nice, idle and waiting time would have been available to this test.
        // Steal is the time that another virtual machine used. It would not have been available.
        let [user, _nice, system, _idle, _iowait, irq, softirq, steal] = *ticks.first_chunk()?;
        let ordinary = user + system + irq + softirq + steal;
        Some(Self { ordinary, ours: of_our_group(), all: ticks[..8].iter().sum() })
    }
}

/// Returns the ticks of all processes in this test's process group, including those that have ended.
fn of_our_group() -> f64 {
    // The program's name may contain any character.
    // The fields after the name are:
    // state, parent, group, ..., utime (12th), stime, and the times of ended children.
    let fields = |process: &str| -> Vec<f64> {
        let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
        let numbers = stat.rsplit(')').next().unwrap_or_default().split_whitespace().skip(1);
        numbers.flat_map(str::parse).collect()
    };
    let ours = fields("self").get(1).copied();
    let all = std::fs::read_dir("/proc").into_iter().flatten().flatten();
    let names = all.filter_map(|entry| entry.file_name().into_string().ok());
    let numbers = names.filter(|name| name.starts_with(|c: char| c.is_ascii_digit()));
    let group = numbers.map(|name| fields(&name)).filter(|fields| fields.get(1).copied() == ours);
    group.filter_map(|fields| Some(fields.get(10..14)?.iter().sum::<f64>())).sum()
}
