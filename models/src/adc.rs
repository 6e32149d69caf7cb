//! Recordings of the left hand: raw converter counts, as read by the Nano.
//!
//! A CSV file has the header `timestamp_ms,x,y,z,index,middle` (or `timestamp`), with 8 to 12 bits at 50 to 500 Hz.
//! The recording is converted to the board's input, which is sums of eight 10-bit conversions at 100 Hz.
//! [`Read::notes`] describes the conversion.
//! `host-bridge record --hand left` writes eighths of a count (512.375), so nothing is lost.
//! Nothing is repaired silently: unusable data causes an error with file, line, column and a remedy.

use std::fmt::Write as _;
use std::path::Path;

use shared_dsp::left::faults::STUCK_MS;
use shared_dsp::left::{AdcCounts, OVERSAMPLING};

use crate::sheet::RecordingError;
use crate::sheet::left::{CHANNEL_NAMES, LeftRow, LeftSheet};

/// The board samples every 10 ms. A recording whose mean interval is close to that is used unchanged.
const INTERVAL_MS: std::ops::RangeInclusive<f64> = 9.0..=11.0;
/// Mean intervals that can be converted, and the corresponding rates.
const USABLE_MS: std::ops::RangeInclusive<f64> = 1.98..=20.2;
const USABLE_HZ: (f64, f64) = (50.0, 500.0);
/// Converter resolutions in bits that the reader infers from the values. It needs at least `ENOUGH` samples.
const BITS: std::ops::RangeInclusive<u32> = 8..=12;
const ENOUGH: usize = 100;

/// Samples of all five channels, and their times.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AdcRecording {
    /// Time and readings of each sample.
    pub samples: Vec<(u64, AdcCounts)>,
}

/// A recording from a file, with notes about its conversion.
#[derive(Clone, Debug, PartialEq)]
pub struct Read {
    /// The recording as the board would have sampled it.
    pub recording: AdcRecording,
    /// Descriptions of everything that was inferred or changed.
    pub notes: Vec<String>,
    /// The first time in the file, in milliseconds.
    pub start_ms: f64,
}

impl AdcRecording {
    /// Reads a CSV file.
    ///
    /// # Errors
    /// Returns a [`RecordingError`] unless the file contains a complete recording.
    pub fn read(file: &Path) -> Result<Read, RecordingError> {
        let bytes =
            std::fs::read(file).map_err(|source| RecordingError::Io { file: file.to_owned(), source })?;
        Self::read_bytes(file, &bytes)
    }

    /// Parses the bytes of a CSV file; `file` is used only in errors.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn parse(file: &Path, bytes: &[u8]) -> Result<Self, RecordingError> {
        Ok(Self::read_bytes(file, bytes)?.recording)
    }

    fn read_bytes(file: &Path, bytes: &[u8]) -> Result<Read, RecordingError> {
        let sheet = LeftSheet::parse(file, bytes)?;
        let samples = &sheet.rows;
        let mut notes = Vec::new();
        let bits = bits(samples);
        let largest = f64::from((1u16 << bits) - 1);
        for row in samples {
            if let Some(channel) = row.conversions.iter().position(|count| *count > largest) {
                return Err(sheet.too_large(row, channel, largest));
            }
        }
        if bits != 10 {
            notes.push(format!("the conversions have {bits} bits, by their values; the board's have 10"));
        }
        let equal = samples.windows(2).filter(|pair| pair[0].time_ms == pair[1].time_ms).count();
        if equal > 0 {
            notes.push(format!("{equal} samples have the time of the one before"));
        }
        let span_ms = samples.last().map_or(0.0, |last| last.time_ms);
        let interval_ms = span_ms / (samples.len() - 1) as f64;
        let eighths = f64::from(OVERSAMPLING) * f64::from(1u16 << 10) / f64::from(1u16 << bits);
        let reading = |counts: [f64; 5]| {
            let [x, y, z, index, middle] =
                counts.map(|count| (count * eighths).round().min(f64::from(AdcCounts::MAX)) as u16);
            AdcCounts { x, y, z, index, middle }
        };
        let samples: Vec<(u64, AdcCounts)> = if INTERVAL_MS.contains(&interval_ms) {
            samples.iter().map(|row| (row.time_ms.round() as u64, reading(row.conversions))).collect()
        } else {
            // A pause must not affect the measured rate of a usable recording.
            let usual = usual_interval(samples);
            if !USABLE_MS.contains(&usual) {
                return Err(sheet.wrong_rate(interval_ms, USABLE_HZ));
            }
            if !INTERVAL_MS.contains(&usual) {
                notes.push(format!("{:.0} samples a second become 100", 1000.0 / usual));
            }
            resampled(samples, usual, reading)
        };
        if let Some((from_ms, for_ms)) = standing_still(&samples) {
            notes.push(format!(
                "from {:.3} s on all five values stay the same for {:.1} s, which the board takes for a stuck converter and \
                 halts: eight conversions added up, as it takes them, are never so still",
                from_ms as f64 / 1000.0,
                for_ms as f64 / 1000.0
            ));
        }
        Ok(Read { recording: AdcRecording { samples }, notes, start_ms: sheet.start_ms })
    }

    /// Returns CSV text with 10-bit conversions. If a value is not a whole number, the text contains eighths.
    pub fn to_csv(&self) -> String {
        let mut text = format!("timestamp_ms,{}\n", CHANNEL_NAMES.join(","));
        for (time_ms, counts) in &self.samples {
            let [x, y, z, index, middle] =
                counts.as_array().map(|sum| f64::from(sum) / f64::from(OVERSAMPLING));
            let _ = writeln!(text, "{time_ms},{x},{y},{z},{index},{middle}");
        }
        text
    }
}

/// Finds the first place where all five values stay equal for so long that the board would report a fault.
/// Returns the start and duration of this period in ms.
fn standing_still(samples: &[(u64, AdcCounts)]) -> Option<(u64, u64)> {
    let mut from = 0;
    while from < samples.len() {
        let same = samples[from..].iter().take_while(|(_, counts)| *counts == samples[from].1).count();
        let long_ms = samples[from + same - 1].0 - samples[from].0;
        if long_ms >= u64::from(STUCK_MS) {
            return Some((samples[from].0, long_ms));
        }
        from += same;
    }
    None
}

/// Infers the resolution of the converter in bits.
/// Straight fingers read two thirds of the range.
/// Most values are below the end of the range, but not all are below its middle.
/// Few samples, or samples with eighths, count as 10 bits.
fn bits(samples: &[LeftRow]) -> u32 {
    let mut all: Vec<f64> = samples.iter().flat_map(|row| row.conversions).collect();
    if samples.len() < ENOUGH || all.iter().any(|count| count.fract() != 0.0) {
        return 10;
    }
    all.sort_unstable_by(f64::total_cmp);
    let high = all[all.len() * 19 / 20];
    BITS.into_iter().find(|bits| high < f64::from(1u16 << bits)).unwrap_or(*BITS.end())
}

/// Median interval in ms.
fn usual_interval(samples: &[LeftRow]) -> f64 {
    let mut steps: Vec<f64> = samples.windows(2).map(|pair| pair[1].time_ms - pair[0].time_ms).collect();
    steps.sort_unstable_by(f64::total_cmp);
    steps[steps.len() / 2]
}

/// Resamples to 10 ms by interpolation. Higher rates use the mean within 5 ms, and pauses have no samples.
fn resampled(
    samples: &[LeftRow],
    usual_ms: f64,
    reading: impl Fn([f64; 5]) -> AdcCounts,
) -> Vec<(u64, AdcCounts)> {
    const STEP_MS: u64 = 10;
    let pause_ms = (3.0 * usual_ms).max(50.0);
    let end_ms = samples.last().map_or(0.0, |last| last.time_ms);
    let mut taken = Vec::new();
    let (mut left, mut from, mut to) = (0, 0, 0);
    // Skips a pause in one step, because a wrong clock can make it extremely long.
    let mut time_ms = 0;
    while time_ms as f64 <= end_ms {
        let at = time_ms as f64;
        while left + 2 < samples.len() && samples[left + 1].time_ms <= at {
            left += 1;
        }
        let (before, after) = (&samples[left], &samples[left + 1]);
        if after.time_ms - before.time_ms > pause_ms && at > before.time_ms {
            time_ms = ((after.time_ms / STEP_MS as f64).ceil() as u64 * STEP_MS).max(time_ms + STEP_MS);
            continue;
        }
        while samples[from].time_ms < at - 5.0 {
            from += 1;
        }
        while to < samples.len() && samples[to].time_ms < at + 5.0 {
            to += 1;
        }
        let near = &samples[from.min(to)..to];
        let counts = std::array::from_fn(|channel| {
            if usual_ms < 7.0 && !near.is_empty() {
                near.iter().map(|row| row.conversions[channel]).sum::<f64>() / near.len() as f64
            } else {
                let (a, b) = (before.conversions[channel], after.conversions[channel]);
                let part =
                    ((at - before.time_ms) / (after.time_ms - before.time_ms).max(1e-9)).clamp(0.0, 1.0);
                a + (b - a) * part
            }
        });
        taken.push((time_ms, reading(counts)));
        time_ms += STEP_MS;
    }
    taken
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "timestamp_ms,x,y,z,index,middle\n";

    fn parse(text: &str) -> Result<AdcRecording, String> {
        AdcRecording::parse(Path::new("left.csv"), text.as_bytes()).map_err(|e| e.to_string())
    }

    #[test]
    fn what_is_written_reads_back() {
        let whole = AdcCounts::from_ten_bit;
        let eighths = AdcCounts { x: 4099, index: 5633, ..whole([0, 1023, 1, 2, 3]) };
        let recording = AdcRecording { samples: vec![(0, whole([512, 500, 614, 704, 700])), (10, eighths)] };
        let text = recording.to_csv();
        assert!(text.ends_with("\n0,512,500,614,704,700\n10,512.375,1023,1,704.125,3\n"), "{text}");
        assert_eq!(parse(&text), Ok(recording));
    }

    #[test]
    fn edge_impulse_time_and_windows_line_ends_are_taken() {
        let text = "timestamp,x,y,z,index,middle\r\n100,1,2,3,4,5\r\n110.0,1,2,3,4,5\r\n";
        assert_eq!(parse(text).unwrap().samples[1], (10, AdcCounts::from_ten_bit([1, 2, 3, 4, 5])));
    }

    /// A level hand with straight fingers that tilts once, read by a converter with this many bits.
    fn level(rate_hz: f64, bits: u32, seconds: f64) -> String {
        let full = f64::from(1u32 << bits);
        let row = |n: usize| {
            let t = n as f64 / rate_hz;
            let tilt = 0.05 * (t * 2.0).sin();
            let counts = [0.52 + tilt, 0.485, 0.61, 0.673, 0.699].map(|part| (part * full).round());
            format!("{},{}\n", t * 1000.0, counts.map(|count| count.to_string()).join(","))
        };
        HEADER.to_owned() + &(0..(seconds * rate_hz) as usize).map(row).collect::<String>()
    }

    #[test]
    fn other_rates_and_bits_become_the_boards() {
        let board = parse(&level(100.0, 10, 3.0)).unwrap();
        for (rate_hz, bits) in
            [(50.0, 10), (104.0, 10), (119.0, 12), (200.0, 8), (250.0, 9), (500.0, 11), (100.0, 12)]
        {
            let text = level(rate_hz, bits, 3.0);
            let read = AdcRecording::read_bytes(Path::new("left.csv"), text.as_bytes()).unwrap();
            assert_eq!(read.notes.is_empty(), rate_hz == 104.0, "{rate_hz}, {bits}: {:?}", read.notes);
            if rate_hz == 104.0 {
                continue;
            }
            assert!(read.recording.samples.len().abs_diff(board.samples.len()) < 4, "{rate_hz}, {bits}");
            for ((time, counts), (time_then, counts_then)) in
                read.recording.samples.iter().zip(&board.samples)
            {
                assert_eq!(time, time_then);
                let near = |(a, b): (u16, u16)| a.abs_diff(b) <= 8 * if bits == 8 { 4 } else { 3 };
                assert!(
                    counts.as_array().into_iter().zip(counts_then.as_array()).all(near),
                    "{rate_hz}, {bits}: {counts:?} {counts_then:?}"
                );
            }
        }
    }

    #[test]
    fn one_value_beyond_the_converters_range_is_an_error_and_no_other_converter() {
        let mut lines: Vec<String> = level(100.0, 10, 3.0).lines().map(str::to_owned).collect();
        lines[150] = "1490,1500,500,600,690,700".to_owned();
        let error = parse(&(lines.join("\n") + "\n")).unwrap_err();
        assert!(error.contains("line 151, column 2 (x)") && error.contains("0 to 1023"), "{error}");
    }

    #[test]
    fn a_hand_that_is_too_still_for_the_board_is_named() {
        let read = |rows: usize| {
            let text: String = (0..rows).map(|n| format!("{},512,500,614,704,700\n", n * 10)).collect();
            AdcRecording::read_bytes(Path::new("left.csv"), (HEADER.to_owned() + &text).as_bytes()).unwrap()
        };
        assert!(read(100).notes.is_empty());
        let notes = read(131).notes;
        assert!(notes[0].starts_with("from 0.000 s on all five values stay the same for 1.3 s"), "{notes:?}");
    }

    #[test]
    fn a_pause_stays_a_pause_at_any_rate() {
        let text = level(50.0, 10, 4.0);
        let late = |line: &str| -> String {
            match line.split_once(',').and_then(|(time, rest)| Some((time.parse::<f64>().ok()?, rest))) {
                Some((time, rest)) if time >= 2000.0 => format!("{},{rest}\n", time + 3000.0),
                _ => format!("{line}\n"),
            }
        };
        let text: String = text.lines().map(late).collect();
        let samples = parse(&text).unwrap().samples;
        let longest = samples.windows(2).map(|pair| pair[1].0 - pair[0].0).max();
        assert_eq!(longest, Some(3020));
    }

    #[test]
    fn separators_decimal_commas_and_the_order_of_columns_do_not_matter() {
        let ours = parse("timestamp_ms,x,y,z,index,middle\n0,1.5,2,3,4,5\n10,1,2,3,4,5\n").unwrap();
        for theirs in [
            "timestamp_ms;x;y;z;index;middle\r\n0;1,5;2;3;4;5\r\n10;1;2;3;4;5\r\n",
            "# a left hand\nindex\tmiddle\tz\ty\tx\ttimestamp\n4\t5\t3\t2\t1,5\t0\n4\t5\t3\t2\t1\t10\n",
        ] {
            assert_eq!(parse(theirs).as_ref(), Ok(&ours));
        }
    }

    #[test]
    fn a_clock_that_jumps_by_decades_is_named() {
        for last in ["1e13", "1e300"] {
            let text = level(50.0, 10, 2.0) + &format!("{last},532,497,625,689,716\n");
            let error = parse(&text).unwrap_err();
            assert!(error.contains("line 102, column 1 (timestamp_ms)"), "{error}");
        }
    }

    #[test]
    fn each_fault_names_file_line_and_column() {
        let row = |text: &str| parse(&format!("{HEADER}0,1,2,3,4,5\n{text}")).unwrap_err();
        for (error, place) in [
            (parse("").unwrap_err(), "left.csv: the file is empty"),
            (parse(HEADER).unwrap_err(), "left.csv: there are no samples"),
            (parse("time,x,y,z,index,middle\n").unwrap_err(), "line 1, column 1 (\"time\")"),
            (
                parse("timestamp_ms,x,y,z,index\n").unwrap_err(),
                "line 1, column 6 (\"middle\"): the column is missing",
            ),
            (
                parse("timestamp_ms,x,y,z,index,middle,a\n").unwrap_err(),
                "line 1, column 7 (\"a\"): a left hand has no such column",
            ),
            (row("10,1,2,3"), "line 3, column 5: the row has 4 values, the header 6"),
            (row("10,1,2,3,4,5,6"), "line 3, column 7: the row has 7"),
            (row("10,1,2,x,4,5"), "line 3, column 4 (z)"),
            (row("10,1,2,1024,4,5"), "line 3, column 4 (z)"),
            (row("10,1,2,1.65,4,5"), "line 3, column 4 (z): \"1.65\" is not a whole number from 0 to 1023"),
            (row("10,1,2,5e2,4,5"), "line 3, column 4 (z)"),
            (row("10,1,2,inf,4,5"), "line 3, column 4 (z)"),
            (row("10,1,2,-1,4,5"), "line 3, column 4 (z)"),
            (row("NaN,1,2,3,4,5"), "line 3, column 1 (timestamp_ms)"),
            (row("0,1,2,3,4,5"), "line 3, column 1 (timestamp_ms)"),
            (row("30,1,2,3,4,5"), "column 1: the sampling rate is 33.3 Hz, but 50 to 500 Hz are needed"),
        ] {
            assert!(error.contains(place), "{error}");
            assert!(error.contains("left.csv"), "{error}");
        }
        let missing = AdcRecording::read(Path::new("no/such.csv")).unwrap_err().to_string();
        assert!(missing.contains("no/such.csv"), "{missing}");
    }

    proptest::proptest! {
        #[test]
        fn damaged_files_never_panic(
            changes in proptest::collection::vec((0usize..9000, 0u8..), 1..20),
            cut in 0usize..9000,
            rate in 0usize..4,
        ) {
            let mut bytes = level([50.0, 100.0, 250.0, 500.0][rate], 10, 1.5).into_bytes();
            for (at, value) in changes {
                let at = at % bytes.len();
                bytes[at] = value;
            }
            let _ = AdcRecording::read_bytes(Path::new("x"), &bytes);
            let _ = AdcRecording::read_bytes(Path::new("x"), &bytes[..cut % bytes.len()]);
        }
    }
}
