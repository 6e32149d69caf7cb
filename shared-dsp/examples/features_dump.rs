//! Converts samples to features as raw bytes, so that they can be compared with another implementation.
//!
//! Usage: `features_dump AXES < samples > features`. All values are little-endian f32.
//! The input has `AXES` values per sample; the output has 13 · `AXES` values per hop.

use shared_dsp::right::features::FeatureWindow;
use std::io::{self, BufReader, BufWriter, Read, Write};

fn main() -> io::Result<()> {
    match std::env::args().nth(1).as_deref() {
        Some("3") => dump::<3>(),
        Some("6") => dump::<6>(),
        Some("9") => dump::<9>(),
        _ => Err(io::Error::other("usage: features_dump 3|6|9 < samples > features (little-endian f32)")),
    }
}

fn dump<const A: usize>() -> io::Result<()> {
    let (mut input, mut output) = (BufReader::new(io::stdin().lock()), BufWriter::new(io::stdout().lock()));
    let mut window = FeatureWindow::<A>::new();
    let mut bytes = vec![0; 4 * A];
    while read_sample(&mut input, &mut bytes)? {
        let sample = std::array::from_fn(|axis| {
            let at = 4 * axis;
            f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
        });
        if window.push(&sample) {
            for feature in window.features().as_flattened() {
                output.write_all(&feature.to_le_bytes())?;
            }
        }
    }
    output.flush()
}

fn read_sample(input: &mut impl Read, bytes: &mut [u8]) -> io::Result<bool> {
    match input.read_exact(bytes) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(false),
        Err(error) => Err(error),
    }
}
