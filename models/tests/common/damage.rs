//! Damages one part of a file, as editors, disks and other programs do.

#[path = "../../../shared-proto/tests/common/rng.rs"]
mod rng;

pub use rng::Rng;

/// Numbers and words that are known to cause failures in parsers.
const TOKENS: [&str; 30] = [
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
    "-0.0",
    "9223372036854775808",
    "0x7f",
    "\"\"",
    "[]",
    "\u{1b}]0;x\u{7}",
];

fn part(rng: &mut Rng, len: usize) -> std::ops::Range<usize> {
    let start = rng.below(len + 1);
    let most = if rng.below(4) == 0 { len - start } else { (len - start).min(12) };
    start..start + rng.below(most + 1)
}

/// Returns the position of a number or a word in a text.
fn token(rng: &mut Rng, bytes: &[u8]) -> std::ops::Range<usize> {
    let is_part = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'.' | b'-' | b'+');
    let at = rng.below(bytes.len() + 1);
    let start = (at..bytes.len()).find(|&i| is_part(bytes[i])).unwrap_or(bytes.len());
    let end = (start..bytes.len()).find(|&i| !is_part(bytes[i])).unwrap_or(bytes.len());
    start..end
}

/// Damages the bytes at one place. `donor` is another file of the same type.
pub fn damage(rng: &mut Rng, bytes: &mut Vec<u8>, donor: &[u8]) {
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
        // Extreme values for lengths and counts in binary files.
        10 | 11 if at + 8 <= bytes.len() => {
            let ends =
                [0, 1, 0x7f, 0x80, 0xff, 0xffff, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, 1 << 40, u64::MAX];
            // The values include infinity and NaN, which damage floating-point fields.
            let numbers: Vec<u64> = ends.into_iter().chain([0x7f80_0000, 0x7fc0_0000]).collect();
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
