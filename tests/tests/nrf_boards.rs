//! Tests the differences between boards: detected sensor, pins, start of the bootloader, and the file to flash.
#![cfg(feature = "nrf")]

use shared_dsp::right::kind::FeatureKind;
use shared_dsp::right::network::Model;
use shared_proto::message::{
    AckResult, FaultKind, HostMessage, Image, Mode, ResetCause, Sensor, Signal, health,
};
use tests::nrf::board::Kind;
use tests::nrf::build::{Variant, image, uf2};
use tests::nrf::lsm9ds1::Still;
use tests::nrf::session::RightRig;
use tests::nrf::soc::{SLOTS_END, SLOTS_START};
use tests::nrf::time::ms;
use tests::nrf::transfer::{announce, begin, install, random_model};
use tests::nrf::usb_host::UsbHost;

/// Creates a board of this type that lies still and has a full window.
fn resting(kind: Kind) -> RightRig {
    let mut session = RightRig::of_kind(kind, Box::new(Still));
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
fn a_board_says_what_it_is_made_of_and_why_it_started() {
    for (kind, sensor, axes, image) in [
        (Kind::Nano33, Sensor::Lsm9ds1, 9, Image::Bootloader),
        (Kind::Nano33Rev2, Sensor::Bmi270, 6, Image::Bootloader),
        (Kind::Xiao, Sensor::Lsm6ds3, 6, Image::Uf2),
    ] {
        let mut session = resting(kind);
        session.board.press_reset();
        session.run_ms(1000);
        session.send(&HostMessage::HelloRequest);
        session.run_ms(100);
        let about = session.heard.about.expect("it says so after its hello");
        assert_eq!((about.sensor, about.axes, about.image), (sensor, axes, image), "{kind:?}");
        assert_eq!((about.reset, about.battery_mv), (ResetCause::Pin, 0), "{kind:?}");
    }
}

/// A Rev2's magnetometer axes have not been measured, and a XIAO has no magnetometer.
#[test]
fn a_model_that_reads_a_magnetometer_is_refused_where_none_may_be_used_and_a_kept_one_names_nothing() {
    let blob = random_model(FeatureKind::LogPower, &[20, 10, 5], 7);
    let model = Model::parse(&blob).unwrap();
    let mut rev1 = RightRig::uart(Box::new(Still));
    rev1.run_ms(500);
    install(&mut rev1, &blob);
    let slots = SLOTS_START as usize..SLOTS_END as usize;
    let kept = rev1.board.soc().flash[slots.clone()].to_vec();
    for kind in OTHERS {
        let mut session = resting(kind);
        assert_eq!(announce(&mut session, begin(&blob, &model)), AckResult::ModelDoesNotFit, "{kind:?}");
        assert_eq!(session.board.soc().nvmc.erased, 0);
        // The flash already contains the model, which came from another board.
        session.board.soc().flash[slots.clone()].copy_from_slice(&kept);
        session.board.press_reset();
        session.heard.states.clear();
        session.run_ms(4000);
        let states = &session.heard.states;
        let fault = session.heard.faults.iter().find(|f| f.kind == FaultKind::NoMagnetometer);
        assert_eq!(fault.map(|f| f.detail), Some(6), "{kind:?}: {:?}", session.heard.faults);
        assert!(states.len() > 20, "{kind:?}: the laptop hears of it as often as of gestures");
        assert!(states.iter().skip(20).all(|s| s.health & health::MODEL != 0 && s.events == 0), "{kind:?}");
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
    let mut session = RightRig::ble_of_kind(Kind::Xiao, Box::new(Still));
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

/// Tests the divider of 1 MΩ and 510 kΩ.
/// If the divider's lower end is not low, the pin gets the battery's voltage.
#[test]
fn the_xiao_measures_its_battery() {
    for (battery_mv, later_mv) in [(3300.0, None), (4150.0, Some(3950.0))] {
        let mut session = RightRig::of_kind(Kind::Xiao, Box::new(Still));
        let mut measures = |battery_mv: f64, milliseconds| {
            session.board.soc().saadc.inputs_mv[7] = battery_mv * 510.0 / 1510.0;
            session.run_ms(milliseconds);
            assert_eq!(session.board.soc().ports[0].drives(14), Some(false));
            let said = session.heard.about.expect("it says so with a status").battery_mv;
            println!("{battery_mv} mV: {said} mV");
            assert!((f64::from(said) - battery_mv).abs() < 6.0, "{said} mV, not {battery_mv}");
        };
        // No program has asked for vibration.
        measures(battery_mv, 1500);
        if let Some(later_mv) = later_mv {
            measures(later_mv, 61_000);
        }
    }
}

/// Reads the file as a bootloader does, block by block, and compares the resulting flash content.
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
        // The file must not overwrite S140 below, or the bond keys, models and bootloader above.
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

/// Returns the changes of the motor's pin during this time: milliseconds and duty cycle.
fn felt(session: &mut RightRig, signal: Signal, milliseconds: u64) -> Vec<(u64, f64)> {
    session.board.soc().pwm1.drives.clear();
    let start = session.board.now();
    session.send(&HostMessage::Feel { signal });
    // The laptop keeps sending pings.
    for id in 0..milliseconds / 100 {
        session.run_ms(100);
        session.send(&HostMessage::Ping { id: id as u32 });
    }
    drives(session, start)
}

fn drives(session: &mut RightRig, start: u64) -> Vec<(u64, f64)> {
    let drives = session.board.soc().pwm1.drives.clone();
    drives.iter().map(|drive| ((drive.at - start) / ms(1), drive.high)).collect()
}

/// Compares the duty cycles and times.
/// The tolerance is some milliseconds, because a frame takes one millisecond on the wire.
fn assert_felt(seen: &[(u64, f64)], wanted: &[(u64, f64)], what: &str) {
    assert_eq!(seen.len(), wanted.len(), "{what}: {seen:?}");
    for ((at_ms, high), (wanted_ms, wanted_high)) in seen.iter().zip(wanted) {
        assert!(at_ms.abs_diff(*wanted_ms) <= 4 && high == wanted_high, "{what}: {seen:?}");
    }
}

#[test]
fn a_vibration_motor_has_a_pattern_for_each_signal_and_for_a_laptop_that_falls_silent() {
    for (kind, pin) in [(Kind::Nano33, (1, 11)), (Kind::Xiao, (0, 2))] {
        let mut session = resting(kind);
        // Without a request, the pin is low and its clock is off.
        session.run_ms(2000);
        assert!(session.board.soc().pwm1.drives.is_empty() && !session.board.soc().pwm1.is_enabled());
        assert_eq!(session.board.soc().ports[pin.0 as usize].drives(pin.1), Some(false));
        for (signal, wanted) in [
            (Signal::Ready, &[][..]),
            (Signal::Accepted, &[(0, 0.6), (80, 0.0)]),
            (Signal::Refused, &[(0, 1.0), (80, 0.0), (180, 1.0), (260, 0.0)]),
            (Signal::Stopped, &[(0, 1.0), (600, 0.0)]),
            (Signal::LinkLost, &[(0, 1.0), (250, 0.0), (400, 1.0), (650, 0.0), (800, 1.0), (1050, 0.0)]),
        ] {
            let seen = felt(&mut session, signal, 1500);
            println!("{kind:?} {signal:?}: {seen:?}");
            assert_felt(&seen, wanted, &format!("{kind:?} {signal:?}"));
            let soc = session.board.soc();
            assert!(soc.pwm1.drives.iter().all(|drive| drive.pin == pin && drive.period_hz == 20_000.0));
            assert!(!soc.pwm1.is_enabled(), "{signal:?}: no clock behind it");
        }
        session.board.soc().pwm1.drives.clear();
        let last_ping = session.board.now();
        session.run_ms(4000);
        let seen = drives(&mut session, last_ping);
        let lost = [(1000, 1.0), (1250, 0.0), (1400, 1.0), (1650, 0.0), (1800, 1.0), (2050, 0.0)];
        assert_felt(&seen, &lost, "a silent laptop");
        let status = session.heard.statuses.last().expect("statuses");
        assert_eq!((status.bad_frames, session.damaged()), (0, 0));
    }
}
