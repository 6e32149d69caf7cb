//! Fixes the wire format. `tests/golden_wire.txt` contains one frame of every message, and `WIRE.md` shows the same bytes.
//!
//! After a deliberate change, increase the version in `message.rs` and then run
//! `BIMANUAL_BLESS=1 cargo test -p shared-proto --test golden`.

use shared_proto::frame::*;
use shared_proto::message::*;
use std::fmt::Write;
use std::path::Path;

const LEFT: BoardMessage<'static> = BoardMessage::Left(LeftState {
    sequence: 300,
    board_time_ms: 61_000,
    pitch_mrad: 349,
    roll_mrad: -20,
    heading: Heading::Forward,
    index_bends: 8,
    middle_bends: 0,
    stop: false,
    health: 0,
});

fn model_info() -> ModelInfo<'static> {
    ModelInfo {
        model_id: 0xCAFE_F00D,
        recipe: 1,
        axes: 9,
        sample_hz: 100,
        window: 200,
        labels: Text("idle,up-down,to-fro,left-right,rectangle,rectangle-flat,circle"),
    }
}

fn board_messages() -> Vec<BoardMessage<'static>> {
    vec![
        BoardMessage::Hello(Hello {
            major: 1,
            minor: 0,
            board: Board::LeftNano,
            firmware: Text("0.1.0"),
            boot_id: 0x1234_5678,
            model_id: 0,
            sample_hz: 100,
        }),
        LEFT,
        BoardMessage::Right(RightState {
            sequence: 1,
            board_time_ms: 2000,
            events: 3,
            label: 6,
            confidence: 250,
            event_window_end_ms: 1920,
            scores: Bytes(&[0, 1, 0, 2, 0, 3, 250]),
            health: health::GAP,
        }),
        BoardMessage::RawImu(RawImu {
            sequence: 2,
            first_sample: 1600,
            axes: 3,
            scale: [0.001, 0.0, 0.0],
            counts: Bytes(&[1, 0, 255, 255, 0, 128]),
        }),
        BoardMessage::Status(Status {
            uptime_ms: 1000,
            dropped_samples: 1,
            sensor_errors: 2,
            bad_frames: 3,
            free_stack_bytes: 700,
            load_permille: 150,
            mode: Mode::Record,
        }),
        BoardMessage::Fault(Fault { uptime_ms: 5, kind: FaultKind::SensorMissing, detail: 0x6B }),
        BoardMessage::Pong(Pong { id: 7, board_time_ms: 70_000 }),
        BoardMessage::Ack(Ack { request: 9, result: AckResult::Ok, next_offset: 128 }),
        BoardMessage::ModelInfo(model_info()),
        BoardMessage::About(About {
            sensor: Sensor::Bmi270,
            axes: 6,
            image: Image::S140,
            reset: ResetCause::Watchdog,
            battery_mv: 3700,
        }),
        BoardMessage::RawAdc(RawAdc { board_time_ms: 61_010, counts: [4096, 0, 4912, 5632, 8184] }),
        BoardMessage::Tilt(RightTilt { sequence: 300, acceleration_mm_s2: [-3354, 0, 9215] }),
        BoardMessage::Pairing(Pairing { kind: PairingKind::Passkey, passkey: 123_456 }),
    ]
}

fn host_messages() -> Vec<HostMessage<'static>> {
    let thresholds = TiltThresholds { neutral_mrad: 87, end_mrad: 209, start_mrad: 262 };
    vec![
        HostMessage::HelloRequest,
        HostMessage::Ping { id: 7 },
        HostMessage::SetMode { request: 8, mode: Mode::Record },
        HostMessage::Calibrate { request: 9, step: CalibrationStep::Bend },
        HostMessage::SetThresholds { request: 10, thresholds },
        HostMessage::ModelBegin(ModelBegin {
            request: 11,
            info: model_info(),
            scaling: [1.0, 1.1469, 1.1469],
            size: 4096,
        }),
        HostMessage::ModelChunk { request: 12, offset: 128, data: Bytes(&[0, 1, 2, 0, 255]) },
        HostMessage::ModelCommit { request: 13, crc32: 0xCAFE_F00D },
        HostMessage::Feel { signal: Signal::Stopped },
        HostMessage::ImageBegin { request: 14, size: 256_000, crc32: 0xCAFE_F00D },
        HostMessage::ImageConfirm { request: 15, crc32: 0xCAFE_F00D },
    ]
}

/// The values of all lists in messages, sorted by their byte on the wire.
fn lists() -> Vec<String> {
    fn list<T: serde::de::DeserializeOwned + std::fmt::Debug>(name: &str) -> String {
        let mut line = format!("list {name}:");
        for byte in 0..=255 {
            let Ok(value) = postcard::from_bytes::<T>(&[byte]) else { continue };
            let value = format!("{value:?}");
            if !value.starts_with("Unknown") {
                write!(line, " {byte:02x}={value}").unwrap();
            }
        }
        line
    }
    vec![
        list::<Board>("Board"),
        list::<FaultKind>("FaultKind"),
        list::<AckResult>("AckResult"),
        list::<Sensor>("Sensor"),
        list::<Image>("Image"),
        list::<ResetCause>("ResetCause"),
        list::<Signal>("Signal"),
        list::<PairingKind>("PairingKind"),
        list::<Heading>("Heading"),
        list::<Mode>("Mode"),
        list::<CalibrationStep>("CalibrationStep"),
    ]
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ")
}

fn board_frame(message: &BoardMessage<'_>) -> Vec<u8> {
    encode_board(message, &mut [0; BOARD_FRAME_MAX]).unwrap().to_vec()
}

fn host_frame(message: &HostMessage<'_>) -> Vec<u8> {
    encode_host(message, &mut [0; HOST_FRAME_MAX]).unwrap().to_vec()
}

/// Omits the first line, which contains the version.
fn golden_now() -> Vec<String> {
    let board = board_messages();
    let host = host_messages();
    board
        .iter()
        .map(|message| format!("board {message:?} = {}", hex(&board_frame(message))))
        .chain(host.iter().map(|message| format!("host {message:?} = {}", hex(&host_frame(message)))))
        .chain(lists())
        .collect()
}

fn version_line(major: u8, minor: u8) -> String {
    format!("protocol {major}.{minor}")
}

#[test]
fn the_wire_has_not_changed_without_a_new_version() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden_wire.txt");
    let old = std::fs::read_to_string(&path).unwrap_or_default();
    let mut old_lines = old.lines();
    let old_version = old_lines.next().unwrap_or_default();
    let old_lines: Vec<&str> = old_lines.collect();
    let version = version_line(PROTOCOL_MAJOR, PROTOCOL_MINOR);
    let now = golden_now();
    if old_version == version && old_lines == now {
        return;
    }

    let kept = |line: &&str| {
        let open =
            ["Board", "FaultKind", "AckResult", "Sensor", "Image", "ResetCause", "Signal", "PairingKind"]
                .iter()
                .any(|list| line.starts_with(&format!("list {list}:")));
        now.iter().any(|new| new == line || open && new.starts_with(*line))
    };
    let gone: Vec<&&str> = old_lines.iter().filter(|line| !kept(line)).collect();
    let frozen =
        gone.iter().any(|line| line.starts_with("board Hello") || line.starts_with("host HelloRequest"));
    assert!(!frozen, "the hello is frozen for ever, in every version: undo the change");
    let same_major = old_version.starts_with(&format!("protocol {PROTOCOL_MAJOR}."));
    assert!(
        gone.is_empty() || !same_major,
        "the wire was reshaped: raise PROTOCOL_MAJOR (or undo the change). No longer so:\n{gone:#?}"
    );
    assert!(
        old.is_empty() || old_version != version,
        "the wire has more than protocol {PROTOCOL_MAJOR}.{PROTOCOL_MINOR} had: raise PROTOCOL_MINOR"
    );
    assert!(
        std::env::var("BIMANUAL_BLESS").is_ok_and(|value| value == "1"),
        "new version, so pin its bytes: BIMANUAL_BLESS=1 cargo test -p shared-proto --test golden"
    );
    std::fs::write(&path, format!("{version}\n{}\n", now.join("\n"))).unwrap();
}

/// Without this check, the tests would not notice a message that is missing in this file.
#[test]
fn every_message_is_in_the_list() {
    let board: Vec<Row> = board_messages().iter().map(|message| *message.row()).collect();
    let host: Vec<Row> = host_messages().iter().map(|message| *message.row()).collect();
    assert_eq!(board, BoardMessage::ROWS);
    assert_eq!(host, HostMessage::ROWS);

    let (board, host) = (BoardMessage::ROWS.len(), HostMessage::ROWS.len());
    let mut payload = [0; 64];
    for number in 0..128 {
        // Zeros are valid values of all fields.
        payload[0] = number as u8;
        assert_eq!(postcard::take_from_bytes::<BoardMessage>(&payload).is_ok(), number < board, "{number}");
        assert_eq!(postcard::take_from_bytes::<HostMessage>(&payload).is_ok(), number < host, "{number}");
        assert_eq!(parse_board(&payload[..1]) == Err(ParseError::Unknown), number >= board, "{number}");
        assert_eq!(parse_host(&payload[..1]) == Err(ParseError::Unknown), number >= host, "{number}");
    }
}

/// This test decodes the stored bytes and does not use the current encoder.
#[test]
fn the_pinned_frames_are_read_as_the_pinned_messages() {
    let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden_wire.txt"));
    let mut frames = 0;
    for line in text.unwrap().lines() {
        let Some((name, bytes)) = line.split_once(" = ") else { continue };
        let bytes: Vec<u8> = bytes.split(' ').map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect();
        let mut decoder = Decoder::<BOARD_FRAME_MAX>::new();
        let mut read = Vec::new();
        for byte in bytes {
            if name.starts_with("board ") {
                read.extend(decoder.push_board(byte).map(|message| format!("board {message:?}")));
            } else {
                read.extend(decoder.push_host(byte).map(|message| format!("host {message:?}")));
            }
        }
        assert_eq!(read, [name]);
        frames += 1;
    }
    assert_eq!(frames, BoardMessage::ROWS.len() + HostMessage::ROWS.len());
}

#[test]
fn wire_md_shows_the_true_bytes() {
    let page = include_str!("../WIRE.md");
    let shows = |row: &str| assert!(page.contains(row), "WIRE.md has no longer (or not yet):\n{row}");

    shows(&format!("protocol {PROTOCOL_MAJOR}.{PROTOCOL_MINOR}"));

    // Checks the diagram byte by byte.
    let frame = board_frame(&LEFT);
    let line = page.lines().find_map(|line| line.strip_prefix("bytes ")).expect("a line of bytes");
    assert_eq!(line.replace('|', " ").split_whitespace().collect::<Vec<_>>().join(" "), hex(&frame));

    // Checks the values.
    fn value<T: serde::Serialize + ?Sized>(value: &T) -> String {
        hex(postcard::to_slice(value, &mut [0; 32]).unwrap())
    }
    for (kind, shown, bytes) in [
        ("u8", "250", value(&250u8)),
        ("u16", "127", value(&127u16)),
        ("u16", "300", value(&300u16)),
        ("u16", "65535", value(&u16::MAX)),
        ("u32", "61000", value(&61_000u32)),
        ("u32", "4294967295", value(&u32::MAX)),
        ("i16", "349", value(&349i16)),
        ("i16", "−20", value(&-20i16)),
        ("i16", "−32768", value(&i16::MIN)),
        ("f32", "1.0", value(&1.0f32)),
        ("bool", "true", value(&true)),
        ("text", "\"0.1.0\"", value("0.1.0")),
        ("bytes", "[0, 255]", value(&[0u8, 255][..])),
        ("list value", "Heading::Forward", value(&Heading::Forward)),
    ] {
        shows(&format!("| {kind} | {shown} | `{bytes}` |"));
    }

    for row in BoardMessage::ROWS.iter().chain(HostMessage::ROWS) {
        let Row { number, name, boards, since, frame_max } = row;
        let since = if *since == 0 { String::new() } else { format!(" (since {PROTOCOL_MAJOR}.{since})") };
        shows(&format!("| `{number:02x}` | `{name}`{since} | {} | {frame_max} |", boards.name()));
    }
    let rows = page.lines().filter(|line| line.starts_with("| `")).count();
    assert_eq!(rows, BoardMessage::ROWS.len() + HostMessage::ROWS.len(), "WIRE.md has a row of no message");
    // The second byte of a frame is the message's number, unless this number is 0.
    for (number, message) in host_messages().iter().enumerate().skip(1) {
        assert_eq!(usize::from(host_frame(message)[1]), number);
    }
    for frame in [board_frame(&board_messages()[6]), host_frame(&HostMessage::HelloRequest)] {
        shows(&format!("`{}`", hex(&frame)));
    }
}
