//! What differs from board to board: the sensor that is found, pins, the way into the bootloader, the file to flash.
#![cfg(feature = "nrf")]

use shared_proto::message::{FaultKind, HostMessage, Mode, health};
use tests::nrf::board::Kind;
use tests::nrf::build::{Variant, image, uf2};
use tests::nrf::lsm9ds1::Still;
use tests::nrf::session::Session;
use tests::nrf::usb_host::UsbHost;

/// A board of this kind that lies still and has filled its window.
fn resting(kind: Kind) -> Session {
    let mut session = Session::of_kind(kind, Box::new(Still));
    session.run_ms(3500);
    let last = session.heard.states.last().expect("states");
    assert_eq!((last.health, last.events), (0, 0), "{kind:?}: {:?}", session.heard.faults);
    assert!(session.heard.faults.is_empty(), "{kind:?}: {:?}", session.heard.faults);
    session
}

const OTHERS: [Kind; 2] = [Kind::Nano33Rev2, Kind::Xiao];

#[test]
fn one_g_and_six_axes_are_recorded_as_a_rev1_board_does() {
    for kind in OTHERS {
        let mut session = resting(kind);
        session.send(&HostMessage::SetMode { request: 1, mode: Mode::Record });
        session.run_ms(500);
        let (_, counts) = session.heard.raw.last().expect("raw samples");
        println!("{kind:?}: {:?}", &counts[..9]);
        assert!((8190..8205).contains(&counts[2]), "{kind:?}: 1 g is 8197 counts, not {}", counts[2]);
        assert_eq!(counts[..2], [0, 0]);
    }
}

#[test]
fn sensor_faults_of_every_board_are_reported_and_mended_within_a_second() {
    for kind in OTHERS {
        let mut session = resting(kind);
        session.board.soc().bus.unplugged = true;
        session.run_ms(2000);
        assert_eq!(session.heard.states.last().unwrap().health & health::SENSOR, health::SENSOR);
        assert!(session.heard.faults.iter().any(|f| f.kind == FaultKind::SensorMissing), "{kind:?}");
        session.board.soc().bus.unplugged = false;
        session.board.soc().bus.sensor.power_cycle();
        session.run_ms(1000);
        assert_eq!(
            session.heard.states.last().unwrap().health & health::SENSOR,
            0,
            "{kind:?}: plugged in again"
        );
        session.board.soc().bus.stuck_clocks = 7;
        session.run_ms(1000);
        assert!(session.heard.faults.iter().any(|f| f.kind == FaultKind::BusStuck), "{kind:?}");
        assert_eq!(session.heard.states.last().unwrap().health & health::SENSOR, 0, "{kind:?}: bus cleared");
        session.board.soc().bus.sensor.power_cycle();
        session.run_ms(1000);
        assert_eq!(session.heard.states.last().unwrap().health & health::SENSOR, 0, "{kind:?}: set up again");
        let errors = session.heard.statuses.last().unwrap().sensor_errors;
        session.board.soc().bus.nacks = 2;
        session.run_ms(1200);
        assert!(session.heard.statuses.last().unwrap().sensor_errors > errors);
        session.run_ms(2000);
        assert_eq!(session.heard.states.last().unwrap().health, 0, "{kind:?}: the window is full again");
        assert!(
            session.board.resets.iter().all(|&reason| reason == 4),
            "{kind:?}: {:?}",
            session.board.resets
        );
    }
}

#[test]
fn the_xiao_runs_over_bluetooth_and_a_touch_at_1200_baud_shows_its_drive() {
    let mut session = Session::xiao_ble(Box::new(Still));
    let mut host = UsbHost::default();
    host.plug_in(&mut session.board);
    for _ in 0..4000 {
        session.run_ms(1);
        host.step(&mut session.board);
    }
    assert!(host.is_ready());
    session.send(&HostMessage::HelloRequest);
    session.run_ms(300);
    assert!(!session.heard.hellos.is_empty());
    assert_eq!(session.heard.about.map(|about| about.axes), Some(6));
    assert!(session.heard.states.len() > 10);
    host.touch();
    for _ in 0..1000 {
        session.run_ms(1);
        host.step(&mut session.board);
        if session.board.in_bootloader {
            break;
        }
    }
    assert!(session.board.in_bootloader);
    session.run_ms(30_000);
    assert!(session.board.in_bootloader, "its bootloader feeds the watchdog");
}

/// Reads the file as a bootloader does: every block by itself, and what it puts into flash.
#[test]
fn the_xiaos_file_puts_every_byte_of_the_image_into_its_place_and_none_elsewhere() {
    let file = uf2();
    assert!(!file.is_empty() && file.len().is_multiple_of(512));
    let blocks = file.len() / 512;
    let mut flash = vec![None; 1 << 20];
    for (n, block) in file.chunks(512).enumerate() {
        let word = |at: usize| u32::from_le_bytes([block[at], block[at + 1], block[at + 2], block[at + 3]]);
        assert_eq!(
            (word(0), word(4), word(508)),
            (0x0A32_4655, 0x9E5D_5157, 0x0AB1_6F30),
            "block {n}: magic"
        );
        assert_eq!(word(8), 0x2000, "block {n}: a family, and nothing else of note");
        assert_eq!(word(28), 0xADA5_2840, "block {n}: nRF52840");
        assert_eq!((word(20) as usize, word(24) as usize), (n, blocks), "block {n}: its number");
        let (at, len) = (word(12) as usize, word(16) as usize);
        assert_eq!(len, 256, "block {n}: bootloaders take 256 bytes");
        assert!(at.is_multiple_of(256));
        // Neither S140 below nor bond keys, models and bootloader above.
        assert!(at >= 0x27000 && at + len <= 0xD7000, "block {n} at {at:#x}");
        for (place, &byte) in flash[at..at + len].iter_mut().zip(&block[32..]) {
            assert_eq!(place.replace(byte), None, "block {n}: {at:#x} comes twice");
        }
    }
    let image = image(Variant::Xiao);
    let mut bytes = 0;
    for (address, piece) in &image.pieces {
        for (i, &byte) in piece.iter().enumerate() {
            assert_eq!(flash[*address as usize + i], Some(byte), "{:#x}", *address as usize + i);
        }
        bytes += piece.len();
    }
    println!("{blocks} blocks carry the {bytes} bytes of the image");
    assert!(blocks * 256 < bytes + 4096);
}
