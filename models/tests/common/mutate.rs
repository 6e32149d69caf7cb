//! Files damaged in every way that editors, disks and other programs can, and what a reader of them must hold to.
#![allow(dead_code)] // each test file uses its own part

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Longest time for one input, where times are looked at (`BIMANUAL_FULL=1`, on a machine of its own).
const LONGEST: Duration = Duration::from_secs(2);
/// Most memory of the whole program, in KiB.
const MEMORY_KIB: u64 = 500 * 1024;

/// Small and even (SplitMix64).
pub struct Rng(pub u64);

impl Rng {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    pub fn below(&mut self, end: usize) -> usize {
        (self.next() % end.max(1) as u64) as usize
    }
}

/// Numbers and words at which readers have been seen to stumble.
const TOKENS: [&str; 24] = [
    "",
    "0",
    "-1",
    "nan",
    "inf",
    "-inf",
    "1e308",
    "-1e-320",
    "9007199254740993",
    "18446744073709551616",
    "4294967295",
    "1e9",
    "0,5",
    "0.5;",
    "\"",
    "\n\n",
    "\r",
    "\t",
    "null",
    "{}",
    "[[",
    "12:30:59.250",
    "timestamp,accX,accY,accZ\n",
    "\u{feff}",
];

fn part(rng: &mut Rng, len: usize) -> std::ops::Range<usize> {
    let start = rng.below(len + 1);
    let most = if rng.below(4) == 0 { len - start } else { (len - start).min(12) };
    start..start + rng.below(most + 1)
}

/// A number or a word of a text, as it stands somewhere.
fn token(rng: &mut Rng, bytes: &[u8]) -> std::ops::Range<usize> {
    let is_part = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'.' | b'-' | b'+');
    let at = rng.below(bytes.len() + 1);
    let start = (at..bytes.len()).find(|&i| is_part(bytes[i])).unwrap_or(bytes.len());
    let end = (start..bytes.len()).find(|&i| !is_part(bytes[i])).unwrap_or(bytes.len());
    start..end
}

/// Damages the bytes once. `donor` is another file of the same kind.
fn damage(rng: &mut Rng, bytes: &mut Vec<u8>, donor: &[u8]) {
    let at = rng.below(bytes.len() + 1);
    match rng.below(14) {
        0 | 1 if at < bytes.len() => bytes[at] ^= 1 << rng.below(8),
        2 if at < bytes.len() => bytes[at] = rng.next() as u8,
        3 => bytes.insert(at, rng.next() as u8),
        4 => drop(bytes.drain(part(rng, bytes.len()))),
        5 => bytes.truncate(at),
        6 => {
            let copy = bytes[part(rng, bytes.len())].to_vec();
            bytes.splice(at..at, copy);
        }
        7 => {
            let copy = donor[part(rng, donor.len())].to_vec();
            bytes.splice(part(rng, bytes.len()), copy);
        }
        8 | 9 => {
            let word = TOKENS[rng.below(TOKENS.len())];
            bytes.splice(token(rng, bytes), word.bytes());
        }
        // Lengths and counts of binary files: the ends of their ranges.
        10 | 11 if at + 8 <= bytes.len() => {
            let numbers = [0, 1, 0x7f, 0x80, 0xff, 0xffff, 0x7fff_ffff, 0xffff_ffff, 1 << 40, u64::MAX];
            let number = numbers[rng.below(numbers.len())].to_le_bytes();
            let width = [1, 2, 4, 8][rng.below(4)];
            bytes[at..at + width].copy_from_slice(&number[..width]);
        }
        12 => {
            let line = |byte: &u8| *byte == b'\n';
            let start = bytes[..at].iter().rposition(line).map_or(0, |n| n + 1);
            let end = bytes[at..].iter().position(line).map_or(bytes.len(), |n| at + n + 1);
            let copy = bytes[start..end].to_vec();
            if rng.below(2) == 0 {
                bytes.drain(start..end);
            } else {
                bytes.splice(start..start, copy);
            }
        }
        _ => {}
    }
}

/// How many inputs a reader is given: few on every run, a million with `BIMANUAL_FULL=1`.
pub fn count(few: u64) -> u64 {
    if is_full() { 1_000_000 } else { few }
}

fn is_full() -> bool {
    std::env::var_os("BIMANUAL_FULL").is_some()
}

/// Gives `read` as many damaged files. It says whether it took the input, and panics where it should not.
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
            // Each input follows from its number.
            let mut rng = Rng(number.wrapping_mul(0x2545_F491_4F6C_DD1D) ^ name.len() as u64);
            let mut bytes = seeds[rng.below(seeds.len())].clone();
            let donor = &seeds[rng.below(seeds.len())];
            for _ in 0..1 + rng.below(6) {
                damage(&mut rng, &mut bytes, donor);
            }
            let began = Instant::now();
            let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| read(&bytes)));
            let took = began.elapsed();
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
    // Otherwise the readers' depths were never reached.
    assert!(taken > inputs / 1000, "{name}: {taken} of {inputs} are read");
    if let Some(kib) = memory_kib() {
        assert!(kib < MEMORY_KIB, "{name}: {kib} KiB");
    }
}

/// The most memory that this program has had, where the system tells.
fn memory_kib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

/// Writes an input down for whoever looks into it; where.
fn keep(name: &str, number: u64, bytes: &[u8]) -> String {
    let name: String = name.chars().map(|c| if c.is_alphanumeric() { c } else { '-' }).collect();
    let file = std::env::temp_dir().join(format!("bimanual-fuzz-{name}-{number}"));
    match std::fs::write(&file, bytes) {
        Ok(()) => file.display().to_string(),
        Err(error) => error.to_string(),
    }
}
