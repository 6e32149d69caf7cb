//! Tests the reader of recordings: each type of damage causes an error that names its location and a solution.

use std::path::Path;

use models::recording::{Recording, RecordingError, write_whole};

fn parse(text: &str) -> Result<Recording, RecordingError> {
    Recording::parse(Path::new("a/b__1.csv"), text.as_bytes())
}

fn error(text: &str) -> String {
    parse(text).expect_err("must be refused").to_string()
}

const GOOD: &str = "timestamp,accX,accY,accZ\n0,1,2,9.8\n10,1,2,9.8\n20,1,2,9.8\n";

#[test]
fn both_time_names_and_three_six_or_nine_axes_are_read() {
    assert_eq!(parse(GOOD).unwrap().axes(), 3);
    let nine = "timestamp_ms,accX,accY,accZ,gyrX,gyrY,gyrZ,magX,magY,magZ\r\n\
                0.00,1,2,3,4,5,6,7,8,9\r\n10.02,1,2,3,4,5,6,7,8,9.5";
    let recording = parse(nine).unwrap();
    assert_eq!((recording.axes(), recording.len()), (9, 2));
    assert_eq!(recording.samples().last().unwrap()[8], 9.5);
    assert_eq!(parse(&format!("\u{feff}{GOOD}")).unwrap().len(), 3);
}

#[test]
fn a_missing_file_is_named() {
    let text = Recording::read(Path::new("/nowhere/x__1.csv")).unwrap_err().to_string();
    assert!(text.starts_with("/nowhere/x__1.csv: ") && text.contains("check the path"), "{text}");
}

#[test]
fn an_empty_file_and_a_header_alone_are_refused() {
    assert_eq!(error(""), "a/b__1.csv: the file is empty; record it again or delete the file");
    assert_eq!(
        error("timestamp,accX,accY,accZ\n"),
        "a/b__1.csv: there are no samples below the header; record it again or delete the file"
    );
    assert_eq!(
        error("timestamp,accX,accY,accZ\n0,1,2,3\n"),
        "a/b__1.csv: one sample is not enough to tell the sampling rate; record it again or delete the file"
    );
}

#[test]
fn wrong_columns_are_named_with_those_that_are_wanted() {
    let wanted = "; a recording has the columns timestamp (or timestamp_ms),accX,accY,accZ\
                  [,gyrX,gyrY,gyrZ[,magX,magY,magZ]] or others that `models import --columns` names";
    for (text, place) in [
        (
            "time,speed,turn\n",
            "a/b__1.csv, line 1, column 1 (\"time\"): no columns of an accelerometer are named",
        ),
        (
            "timestamp,accX,accY,accZ,gyrX\n",
            "a/b__1.csv, line 1, column 5 (\"gyrX\"): this sensor has no y and no z; delete what is not whole, \
             name columns with --columns, or record it again",
        ),
        (
            "0,1,2,3\n",
            "a/b__1.csv, line 1, column 1 (\"0\"): the file has no header; name its columns with --columns",
        ),
    ] {
        assert_eq!(error(text), format!("{place}{wanted}"));
    }
}

#[test]
fn a_truncated_row_is_named_with_its_line() {
    let text = error("timestamp,accX,accY,accZ\n0,1,2,3\n10,1,2,3\n20,1,2\n");
    assert_eq!(
        text,
        "a/b__1.csv, line 4, column 4: the row has 3 values, the header 4; the file may be cut off \
         or damaged here: delete the line or record it again"
    );
    assert!(error("timestamp,accX,accY,accZ\n0,1,2,3,4\n").contains("line 2, column 5: the row has 5"));
}

#[test]
fn a_value_that_is_no_finite_number_is_named_with_line_and_column() {
    assert_eq!(
        error("timestamp,accX,accY,accZ\n0,1,2,3\n10,1,x7,3\n"),
        "a/b__1.csv, line 3, column 3 (accY): \"x7\" is not a number; correct the value or delete the line"
    );
    for bad in ["NaN", "inf", "-inf", "1e99"] {
        let text = error(&format!("timestamp,accX,accY,accZ\n0,1,2,{bad}\n"));
        assert!(
            text.contains(&format!("line 2, column 4 (accZ): \"{bad}\" is not a finite number")),
            "{text}"
        );
    }
    assert!(error("timestamp,accX,accY,accZ\n0,1,,3\n").contains("column 3 (accY): \"\" is not a number"));
}

#[test]
fn time_that_falls_or_never_rises_is_named() {
    for second in ["0", "-5"] {
        let text = error(&format!("timestamp,accX,accY,accZ\n0,1,2,3\n{second},1,2,3\n"));
        assert!(
            text.contains(&format!(
                "line 3, column 1 (timestamp): time {second} ms follows 0 ms; times must rise"
            )),
            "{text}"
        );
    }
}

#[test]
fn rates_outside_25_to_500_hz_are_refused_and_inside_accepted() {
    let at = |interval: f64| {
        let rows: String = (0..50).map(|n| format!("{},1,2,9.5\n", f64::from(n) * interval)).collect();
        parse(&format!("timestamp,accX,accY,accZ\n{rows}"))
    };
    assert!(at(0.1).unwrap_err().to_string().contains("the sampling rate is 10000.0 Hz"));
    assert!(at(50.0).unwrap_err().to_string().contains("25 to 500 Hz are needed"));
    for interval in [2.0, 8.403, 10.0, 40.0] {
        assert!(at(interval).is_ok(), "{interval}");
    }
    // The times are in seconds. The reader infers this from the rate and reports it in a note.
    let seconds = at(0.01).unwrap();
    assert!((seconds.rate_hz() - 100.0).abs() < 1e-6);
    assert_eq!(seconds.notes(), ["times (timestamp) are in s, by the rate"]);
}

#[test]
fn a_clock_that_jumps_by_days_is_named_and_an_hours_pause_is_not() {
    let until = |last: &str| {
        let rows: String = (0..50).map(|n| format!("{},1,2,9.5\n", 10 * n)).collect();
        parse(&format!("timestamp,accX,accY,accZ\n{rows}{last},1,2,9.5\n"))
    };
    assert_eq!(until("3600000").unwrap().len(), 51);
    for (last, told) in [("1e9", "is 278 h long"), ("1e300", "its clock has jumped")] {
        let text = until(last).unwrap_err().to_string();
        assert!(text.contains(told) && text.contains("models import"), "{text}");
    }
}

#[test]
fn bytes_that_are_not_text_are_an_error() {
    let bytes = b"timestamp,accX,accY,accZ\n0,1,\xff\xfe,3\n";
    let text = Recording::parse(Path::new("x.csv"), bytes).unwrap_err().to_string();
    assert!(text.starts_with("x.csv, line 2: "), "{text}");
}

fn sine(rate_hz: f64, seconds: f64, freq_hz: f64) -> Recording {
    let count = (rate_hz * seconds) as usize;
    let time_ms: Vec<f64> = (0..count).map(|n| 5.0 + n as f64 * 1000.0 / rate_hz).collect();
    let values = time_ms
        .iter()
        .flat_map(|t| {
            let v = ((t - 5.0) / 1000.0 * freq_hz * std::f64::consts::TAU).sin() as f32;
            [v, 2.0 * v, 9.81]
        })
        .collect();
    Recording::new(3, time_ms, values)
}

#[test]
fn any_rate_becomes_100_hz_with_the_same_motion() {
    for rate_hz in [25.0, 50.0, 104.0, 119.0, 200.0, 476.0, 500.0] {
        let resampled = sine(rate_hz, 4.0, 1.5).resampled();
        assert!((resampled.rate_hz() - 100.0).abs() < 1e-9, "{rate_hz}");
        assert!((resampled.seconds() - 4.0).abs() < 0.05, "{rate_hz}: {}", resampled.seconds());
        for (n, sample) in resampled.samples().enumerate() {
            let want = (n as f32 / 100.0 * 1.5 * std::f32::consts::TAU).sin();
            assert!((sample[0] - want).abs() < 0.03, "{rate_hz} {n}: {} {want}", sample[0]);
            assert!((sample[2] - 9.81).abs() < 1e-5);
        }
    }
}

#[test]
fn what_is_too_fast_for_100_hz_does_not_fold_back() {
    // If resampling only picked samples, 99 Hz at a rate of 500 Hz would look like a slow 1 Hz swing of full amplitude.
    // The first and last samples are excluded, because they have neighbours on only one side.
    let resampled = sine(500.0, 4.0, 99.0).resampled();
    let largest =
        resampled.samples().skip(1).take(resampled.len() - 2).map(|s| s[0].abs()).fold(0.0, f32::max);
    assert!(largest < 0.15, "{largest}");
}

#[test]
fn a_recording_at_100_hz_is_taken_sample_for_sample() {
    let recording = sine(99.84, 3.0, 2.0);
    let resampled = recording.resampled();
    assert!(resampled.samples().eq(recording.samples()));
    assert_eq!(resampled.time_ms()[1], 10.0);
}

#[test]
fn a_gap_is_counted_and_bridged() {
    let recording = parse("timestamp,accX,accY,accZ\n0,0,0,0\n10,1,0,0\n20,2,0,0\n80,8,0,0\n90,9,0,0\n");
    let recording = recording.unwrap();
    assert_eq!(recording.gaps(), 1);
    let x: Vec<f32> = recording.resampled().samples().map(|s| s[0]).collect();
    assert_eq!(x, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]);
}

#[test]
fn what_is_written_reads_back_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("p__1.csv");
    let recording = parse(GOOD).unwrap();
    recording.write(&file).unwrap();
    assert_eq!(Recording::read(&file).unwrap(), recording);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file stays");
}

#[test]
fn a_failed_write_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("taken")).unwrap();
    assert!(write_whole(&folder.path().join("taken"), b"x").is_err());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}
