use std::path::Path;

use super::*;

/// Rows of a waving hand, generated from a time in ms and nine values in our units.
fn rows(count: usize, row: impl Fn(f64, [f64; 9]) -> String) -> String {
    let one = |n: usize| {
        let t = n as f64 * 0.01;
        let s = (t * 9.0).sin();
        let acc = [3.0 * s + 1.0, 0.5, 9.7 + (t * 5.0).cos()];
        let gyr = [60.0 * s, 20.0, -40.0 * (t * 5.0).cos()];
        row(4000.0 + t * 1000.0, [acc[0], acc[1], acc[2], gyr[0], gyr[1], gyr[2], 20.0, -10.0 * s, 40.0])
    };
    (0..count).map(|n| one(n) + "\n").collect()
}

fn all(values: &[f64], separator: &str) -> String {
    values.iter().map(f64::to_string).collect::<Vec<_>>().join(separator)
}

fn read_as(name: &str, text: &str, reading: &Reading) -> Result<Sheet, String> {
    parse(Path::new(name), text.as_bytes(), reading).map_err(|error| error.to_string())
}

fn guessed(text: &str) -> Sheet {
    read_as("me__1.csv", text, &Reading { guess: true, ..Reading::default() }).unwrap()
}

fn direct(text: &str) -> Result<Sheet, String> {
    read_as("me__1.csv", text, &Reading::default())
}

/// The recording that all test files contain, in our own format.
fn ours(axes: usize) -> Recording {
    let header = crate::recording::AXIS_NAMES[..axes].join(",");
    let text = format!("timestamp,{header}\n{}", rows(300, |t, v| format!("{t},{}", all(&v[..axes], ","))));
    direct(&text).unwrap().takes.remove(0)
}

fn assert_same(sheet: &Sheet, axes: usize) {
    let ours = ours(axes);
    assert_eq!(sheet.takes.len(), 1, "{:?}", sheet.notes);
    let take = &sheet.takes[0];
    assert_eq!((take.axes(), take.len()), (axes, ours.len()), "{:?}", sheet.notes);
    for (n, (a, b)) in take.samples().zip(ours.samples()).enumerate() {
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 2e-3), "{n}: {a:?} {b:?}");
    }
    let start = |recording: &Recording| recording.time_ms()[0];
    let close = |(a, b): (&f64, &f64)| (a - start(take) - (b - start(&ours))).abs() < 0.6;
    assert!(take.time_ms().iter().zip(ours.time_ms()).all(close));
}

#[test]
fn separators_decimal_commas_order_and_extra_columns_do_not_matter() {
    let nine = "timestamp;accX;accY;accZ;gyrX;gyrY;gyrZ;magX;magY;magZ";
    let commas = rows(300, |t, v| format!("{t};{}", all(&v, ";")).replace('.', ","));
    assert_same(&direct(&format!("{nine}\n{commas}")).unwrap(), 9);
    let blanks = nine.replace(';', " ");
    assert_same(
        &direct(&format!("{blanks}\n{}", rows(300, |t, v| format!("{t}  {}", all(&v, " "))))).unwrap(),
        9,
    );
    let turned = "label,gyrX,gyrY,gyrZ,accZ,accY,accX,timestamp,note\n".to_owned()
        + &rows(300, |t, v| format!("wave,{},{},{},{},{t},\"a,b\"", all(&v[3..6], ","), v[2], v[1], v[0]));
    assert_same(&direct(&turned).unwrap(), 6);
    let bytes: Vec<u8> = format!("{nine}\r\n{commas}").encode_utf16().flat_map(u16::to_le_bytes).collect();
    let sheet = parse(Path::new("x"), &[&b"\xff\xfe"[..], &bytes].concat(), &Reading::default()).unwrap();
    assert_same(&sheet, 9);
}

const G: f64 = 9.806_65;

#[test]
fn a_recording_in_g_is_a_question_or_a_guess_that_is_said() {
    let text = format!(
        "timestamp,accX,accY,accZ\n{}",
        rows(300, |t, v| format!("{t},{}", all(&[v[0] / G, v[1] / G, v[2] / G], ",")))
    );
    let error = direct(&text).unwrap_err();
    assert!(error.contains("gravity at rest is about 0.98 m/s²") && error.contains("--units g"), "{error}");
    let sheet = guessed(&text);
    assert_same(&sheet, 3);
    assert_eq!(sheet.notes, ["the accelerometer is in g, by gravity"]);
    let told = |units: &str| {
        let units = units.parse().unwrap();
        read_as("me__1.csv", &text, &Reading { units, ..Reading::default() })
    };
    assert_same(&told("g").unwrap(), 3);
    let wrong = told("m/s2").unwrap_err();
    assert!(wrong.contains("as --units has it, gravity at rest is about 1 m/s²"), "{wrong}");
    // A declared unit that contradicts gravity is never accepted.
    let declared = text.replace("accX,accY,accZ", "accX (m/s^2),accY (m/s^2),accZ (m/s^2)");
    let error = read_as("x", &declared, &Reading { guess: true, ..Reading::default() }).unwrap_err();
    assert!(error.contains("in the unit that the file declares") && error.contains("--units g"), "{error}");
    let declared = text.replace("accX,accY,accZ", "accX (g),accY (g),accZ (g)");
    assert_same(&direct(&declared).unwrap(), 3);
}

#[test]
fn missing_gravity_and_raw_counts_are_named() {
    let linear = format!(
        "timestamp,accX,accY,accZ\n{}",
        rows(300, |t, v| format!("{t},{}", all(&[v[0] - 1.0, v[1] - 0.5, v[2] - 9.7], ",")))
    );
    let error = direct(&linear).unwrap_err();
    assert!(error.contains("no gravity") && error.contains("linear acceleration cannot be used"), "{error}");
    let counts = format!(
        "timestamp,accX,accY,accZ\n{}",
        rows(300, |t, v| format!(
            "{t},{}",
            all(&v[..3].iter().map(|a| a / G * 8192.0).collect::<Vec<_>>(), ",")
        ))
    );
    let error = direct(&counts).unwrap_err();
    assert!(error.contains("raw counts") && error.contains("--units 16384/g"), "{error}");
    let units = "8192/g".parse().unwrap();
    assert_same(&read_as("x", &counts, &Reading { units, ..Reading::default() }).unwrap(), 3);
}

#[test]
fn turns_in_radians_and_fields_in_gauss_are_questions_or_guesses() {
    let text = format!(
        "timestamp,accX,accY,accZ,gyrX,gyrY,gyrZ,magX,magY,magZ\n{}",
        rows(300, |t, v| {
            let gyr = v[3..6].iter().map(|w| w.to_radians());
            let scaled: Vec<f64> =
                v[..3].iter().copied().chain(gyr).chain(v[6..].iter().map(|b| b / 100.0)).collect();
            format!("{t},{}", all(&scaled, ","))
        })
    );
    let error = direct(&text).unwrap_err();
    assert!(error.contains("the gyroscope") && error.contains("--units rad/s"), "{error}");
    let sheet = guessed(&text);
    assert_same(&sheet, 9);
    assert_eq!(sheet.notes.len(), 2, "{:?}", sheet.notes);
    let units = "rad/s,gauss".parse().unwrap();
    assert_same(&read_as("x", &text, &Reading { units, ..Reading::default() }).unwrap(), 9);
}

#[test]
fn times_may_be_equal_in_seconds_of_the_day_or_missing() {
    // A clock that counts milliseconds occasionally repeats a time at 104 Hz.
    let mut last = 0.0;
    let text: String = (0..400)
        .map(|n| {
            let time = (f64::from(n) * 9.615).floor() - f64::from(n % 50 == 25) * 9.0;
            last = f64::max(last, time);
            format!("{last},1,0.5,9.7\n")
        })
        .collect();
    let sheet = direct(&format!("timestamp,accX,accY,accZ\n{text}")).unwrap();
    assert!(sheet.takes[0].time_ms().windows(2).all(|pair| pair[1] > pair[0]));
    let seconds =
        format!("time,ax,ay,az\n{}", rows(300, |t, v| format!("{},{}", t / 1000.0, all(&v[..3], ","))));
    assert_same(&direct(&seconds).unwrap(), 3);
    let of_day = format!(
        "Date;ax;ay;az\n{}",
        rows(300, |t, v| format!("2026-05-01 23:10:{:06.3};{}", t / 1000.0, all(&v[..3], ";")))
    );
    assert_same(&direct(&of_day).unwrap(), 3);
    let none = format!("aX,aY,aZ,gX,gY,gZ\n{}", rows(300, |_, v| all(&v[..6], ",")));
    let error = direct(&none).unwrap_err();
    assert!(error.contains("no column of times") && error.contains("--rate 119"), "{error}");
    let reading = Reading { rate_hz: Some(100.0), ..Reading::default() };
    assert_same(&read_as("x", &none, &reading).unwrap(), 6);
}

#[test]
fn blank_lines_and_repeated_headers_part_recordings() {
    let part = rows(119, |_, v| all(&v[..6], ","));
    let header = "aX,aY,aZ,gX,gY,gZ";
    let reading = Reading { rate_hz: Some(119.0), ..Reading::default() };
    let arduino = format!("{header}\n{part}\n{part}\n\n{part}\n\n");
    let sheet = read_as("x", &arduino, &reading).unwrap();
    assert_eq!(sheet.takes.iter().map(Recording::len).collect::<Vec<_>>(), [119, 119, 119]);
    let dumped = format!("IMU found.\nSampling:\n{header}\n{part}{header}\n{part}");
    assert_eq!(read_as("x", &dumped, &reading).unwrap().takes.len(), 2);
    let timed = rows(119, |t, v| format!("{t},{}", all(&v[..3], ",")));
    let text = format!("timestamp,accX,accY,accZ\n{timed}\n{timed}");
    assert_eq!(guessed(&text).takes.len(), 2);
    // A blank line within a continuous recording has no effect.
    let first: String = timed.lines().take(60).map(|line| format!("{line}\n")).collect();
    let rest: String = timed.lines().skip(60).map(|line| format!("{line}\n")).collect();
    assert_eq!(direct(&format!("timestamp,accX,accY,accZ\n{first}\n{rest}")).unwrap().takes.len(), 1);
    let error = Recording::parse(Path::new("x"), text.as_bytes()).unwrap_err().to_string();
    assert!(error.contains("2 recordings") && error.contains("models import"), "{error}");
}

#[test]
fn columns_can_be_named_by_order_by_name_and_by_number() {
    let bare = rows(300, |t, v| format!("{t},7,{}", all(&v[..6], ",")));
    let error = direct(&bare).unwrap_err();
    assert!(error.contains("no header") && error.contains("--columns"), "{error}");
    let named = |text: &str, columns: &str| {
        let columns = Some(columns.parse().unwrap());
        read_as("x", text, &Reading { columns, ..Reading::default() })
    };
    assert_same(&named(&bare, "time,-,accX,accY,accZ,gyrX,gyrY,gyrZ").unwrap(), 6);
    assert_same(&named(&bare, "time=1,accX=3,accY=4,accZ=5").unwrap(), 3);
    let odd = format!("when,id,p,q,r,u,v,w\n{bare}");
    assert_same(&named(&odd, "time=when,accX=p,accY=q,accZ=r,gyrX=u,gyrY=v,gyrZ=w").unwrap(), 6);
    assert!(named(&odd, "accX=p,accY=q,accZ=zz").unwrap_err().contains("\"zz\""));
    for (columns, told) in [
        ("time,accX,accY", "accZ is not named"),
        ("time,accX,accY,accZ,accX", "twice"),
        ("time,accX,accY,accZ,speed", "our columns are time, accX"),
    ] {
        let error = columns.parse::<Columns>().unwrap_err();
        assert!(error.contains(told), "{error}");
    }
}

#[test]
fn what_serial_plotters_take_is_read() {
    let text = rows(300, |_, v| format!("aX:{},aY:{},aZ:{}", v[0], v[1], v[2]));
    let reading = Reading { rate_hz: Some(100.0), ..Reading::default() };
    assert_same(&read_as("x", &text, &reading).unwrap(), 3);
    let tabs = rows(300, |t, v| format!("t:{t}\tax:{}\tay:{}\taz:{}", v[0], v[1], v[2]));
    assert_same(&direct(&tabs).unwrap(), 3);
}

#[test]
fn files_of_one_sensor_each_become_one_recording() {
    let of = |from: usize| {
        let text = rows(300, |t, v| format!("{},{},{},{}", t / 1000.0, v[from + 2], v[from + 1], v[from]));
        format!("seconds_elapsed,z,y,x\n{text}").into_bytes()
    };
    let gyroscope = {
        let text = rows(310, |t, v| {
            let w = [v[5].to_radians(), v[4].to_radians(), v[3].to_radians()];
            format!("{},{}", t / 1000.0, all(&w, ","))
        });
        format!("seconds_elapsed,z,y,x\n{text}").into_bytes()
    };
    let files = [
        (Path::new("Gyroscope.csv"), gyroscope),
        (Path::new("TotalAcceleration.csv"), of(0)),
        (Path::new("Magnetometer.csv"), of(6)),
    ];
    let sheet = merge(&files, &Reading { guess: true, ..Reading::default() }).unwrap().unwrap();
    assert_same(&sheet, 9);
    assert!(merge(&files[..1], &Reading::default()).unwrap().is_none(), "no accelerometer");
}

#[test]
fn an_axis_that_is_missing_and_columns_that_are_there_twice_are_named() {
    for (header, told) in [
        ("timestamp,accX,accY", "\"accX\"): this sensor has no z"),
        ("timestamp,accX,accY,accZ,gyrX", "column 5 (\"gyrX\"): this sensor has no y and no z"),
        ("timestamp,accX,accY,accZ,accX", "column 5 (\"accX\"): this column is there twice"),
        ("a,b,c", "no columns of an accelerometer are named"),
    ] {
        let error = direct(&format!("{header}\n0,1,2,3,4\n")).unwrap_err();
        assert!(error.contains(told), "{error}");
    }
}

proptest::proptest! {
    #[test]
    fn damaged_files_never_panic(
        changes in proptest::collection::vec((0usize..6000, 0u8..), 1..20),
        cut in 0usize..6000,
        noise in proptest::collection::vec(0u8.., 0..300),
    ) {
        let mut bytes = format!("timestamp,accX,accY,accZ,gyrX,gyrY,gyrZ\n{}", rows(60, |t, v| format!("{t},{}", all(&v[..6], ",")))).into_bytes();
        for (at, value) in changes {
            let at = at % bytes.len();
            bytes[at] = value;
        }
        for reading in [Reading::default(), Reading { guess: true, rate_hz: Some(100.0), ..Reading::default() }] {
            let _ = parse(Path::new("x"), &bytes, &reading);
            let _ = parse(Path::new("x"), &bytes[..cut % bytes.len()], &reading);
            let _ = parse(Path::new("gyro.csv"), &noise, &reading);
        }
    }
}
