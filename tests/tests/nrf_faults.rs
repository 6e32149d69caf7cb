//! Tests faults on the hand: no panic, no false gesture, recovery within a second, and a report.
#![cfg(feature = "nrf")]

use shared_proto::message::{FaultKind, HostMessage, Mode, health};
use tests::nrf::lsm9ds1::Still;
use tests::nrf::session::RightRig;

/// Creates a board that lies still and has a full window.
fn resting() -> RightRig {
    let mut session = RightRig::uart(Box::new(Still));
    session.run_ms(3000);
    assert_eq!(session.heard.states.last().unwrap().health, 0);
    session
}

/// Checks that samples resume within a second, the window fills, and no gesture was reported.
fn recovers(session: &mut RightRig, what: &str) {
    let dropped = |s: &RightRig| s.heard.statuses.last().unwrap().dropped_samples;
    session.run_ms(1000);
    let sensor_ok = session.heard.states.last().unwrap().health & health::SENSOR == 0;
    assert!(sensor_ok, "{what}: the sensor is still away after a second");
    session.run_ms(1000);
    let before = dropped(session);
    session.run_ms(2000);
    assert_eq!(dropped(session), before, "{what}: samples are still lost");
    let last = session.heard.states.last().unwrap();
    assert_eq!((last.health, last.events), (0, 0), "{what}");
    assert!(session.board.resets.iter().all(|&r| r == 4), "{what}: {:?}", session.board.resets);
    assert!(!session.heard.faults.iter().any(|f| f.kind == FaultKind::Panic));
    println!("{what}: recovered, {} samples lost", before);
}

#[test]
fn single_transfers_that_nobody_acknowledges_lose_no_sample() {
    let mut session = resting();
    let before = *session.heard.statuses.last().unwrap();
    for _ in 0..5 {
        session.board.soc().bus.nacks = 2;
        session.run_ms(200);
    }
    session.run_ms(1100);
    let after = *session.heard.statuses.last().unwrap();
    assert!(after.sensor_errors >= before.sensor_errors + 5);
    assert_eq!(after.dropped_samples, before.dropped_samples);
    assert!(session.heard.states.iter().rev().take(20).all(|s| s.health == 0 && s.events == 0));
}

#[test]
fn an_unplugged_sensor_is_reported_and_taken_back_within_a_second() {
    let mut session = resting();
    session.board.soc().bus.unplugged = true;
    session.run_ms(2000);
    let last = session.heard.states.last().unwrap();
    assert_eq!(last.health & health::SENSOR, health::SENSOR);
    assert!(session.heard.faults.iter().any(|f| f.kind == FaultKind::SensorMissing));
    assert!(
        session.board.soc().led()[0] || session.run_until_that(1100, |s| s.board.soc().led()[0]),
        "red light"
    );
    session.board.soc().bus.unplugged = false;
    session.board.soc().bus.sensor.power_cycle();
    recovers(&mut session, "unplugged sensor");
}

#[test]
fn a_bus_that_a_device_holds_is_cleared() {
    let mut session = resting();
    session.board.soc().bus.stuck_clocks = 7;
    recovers(&mut session, "stuck bus");
    assert!(session.heard.faults.iter().any(|f| f.kind == FaultKind::BusStuck));
}

#[test]
fn a_sensor_that_lost_its_settings_is_set_up_again() {
    let mut session = resting();
    session.board.soc().bus.sensor.power_cycle();
    recovers(&mut session, "sensor reset");
}

#[test]
fn a_sensor_that_takes_35_ms_to_start_is_no_fault() {
    let mut session = resting();
    session.send(&HostMessage::HelloRequest);
    session.run_ms(200);
    assert!(!session.heard.hellos.is_empty());
    assert!(session.heard.faults.is_empty(), "{:?}", session.heard.faults);
}

#[test]
fn a_lost_setting_of_the_scale_is_noticed_and_set_again() {
    let mut session = RightRig::uart(Box::new(Still));
    // Without CTRL_REG6_XL, the accelerometer would stay at ±2 g.
    // The gravity of a resting hand would then double.
    session.board.soc().bus.sensor.lose_write(0x20);
    session.run_ms(1000);
    session.send(&HostMessage::SetMode { request: 1, mode: Mode::Record });
    session.run_ms(1000);
    let (_, counts) = session.heard.raw.last().expect("raw samples");
    assert!((8190..8205).contains(&counts[2]), "1 g is 8197 counts at ±4 g, not {}", counts[2]);
}

#[test]
fn an_open_serial_line_brings_no_noise() {
    let mut session = RightRig::uart(Box::new(Still));
    session.board.soc().unplug_uart();
    session.run_ms(4000);
    assert_eq!(session.heard.statuses.last().unwrap().bad_frames, 0);
}

#[test]
fn what_the_bootloader_leaves_running_writes_to_no_memory_of_ours() {
    let mut session = RightRig::uart(Box::new(Still));
    // A byte arrives during the start, and the bootloader's receiver would write it over the image's statics.
    session.board.uart_in(b"x");
    session.run_ms(1);
    assert_ne!(session.board.soc().ram.get(0x2000_9BD4, 1), Some(&b"x"[..]));
    session.run_ms(500);
    assert_eq!(session.board.soc().uart.pins_while_on, 0, "pins are chosen only while the port is off");
}

#[test]
fn a_clock_interrupt_that_the_bootloader_leaves_enabled_is_no_storm() {
    let mut session = RightRig::uart(Box::new(Still));
    session.board.leave_clock_interrupt();
    session.run_ms(1500);
    assert!(session.heard.states.len() > 10, "{:?}", session.board.resets);
}

#[test]
fn the_bus_keeps_to_the_time_that_i2c_wants() {
    let mut session = RightRig::uart(Box::new(Still));
    session.run_ms(1000);
    assert_eq!(session.board.soc().twim.too_fast, 0, "erratum 219: 400 kHz has too short a low period");
}

#[test]
fn a_panic_is_reported_although_the_bootloader_uses_ram_in_between() {
    let mut session = resting();
    let panic = session.board.image().functions_with(&["restart_after_panic"]);
    let before = session.board.resets.len();
    session.board.jump(&panic[0]);
    session.run_ms(500);
    assert_eq!(session.board.resets[before..], [4]);
    session.send(&HostMessage::HelloRequest);
    session.run_ms(100);
    assert!(session.heard.faults.iter().any(|f| f.kind == FaultKind::Panic), "{:?}", session.heard.faults);
}

#[test]
fn random_bytes_from_the_laptop_are_counted_and_change_nothing() {
    let mut session = resting();
    let mut random = 12345u64;
    let mut sent = 0;
    for _ in 0..20 {
        let bytes: Vec<u8> = (0..400)
            .map(|_| {
                random =
                    random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (random >> 56) as u8
            })
            .collect();
        session.board.uart_in(&bytes);
        sent += bytes.len();
        session.run_ms(50);
    }
    let pongs = session.heard.pongs;
    session.run_ms(100);
    // A delimiter ends the frame that the noise started.
    session.board.uart_in(&[0]);
    session.send(&HostMessage::Ping { id: 7 });
    session.run_ms(50);
    assert_eq!(session.heard.pongs, pongs + 1);
    recovers(&mut session, "random bytes");
    let status = session.heard.statuses.last().unwrap();
    println!("{sent} random bytes, {} damaged frames counted", status.bad_frames);
    assert!(status.bad_frames > 5);
    assert_eq!(status.mode, Mode::Classify);
}

#[test]
fn a_board_whose_tasks_stand_still_is_restarted_by_its_watchdog_and_says_so() {
    let mut session = resting();
    let hello = session.heard.hellos.len();
    // The processor stops for longer than the watchdog's time-out.
    let soc = session.board.soc();
    soc.nvmc.busy_until = soc.now + tests::nrf::time::ms(2500);
    session.run_ms(4000);
    assert!(session.board.resets.contains(&2), "{:?}", session.board.resets);
    session.send(&HostMessage::HelloRequest);
    session.run_ms(100);
    // The board sends one hello at the start and one as a reply.
    assert_eq!(session.heard.hellos.len(), hello + 2);
    assert!(session.heard.faults.iter().any(|f| f.kind == FaultKind::Watchdog));
}

#[test]
fn in_record_mode_every_sample_arrives_once_and_in_order() {
    let mut session = resting();
    let ack = session.ask(5, &HostMessage::SetMode { request: 5, mode: Mode::Record }).expect("an answer");
    assert_eq!(ack.result, shared_proto::message::AckResult::Ok);
    session.heard.raw.clear();
    session.run_ms(10_000);
    let raw = &session.heard.raw;
    assert!(raw.windows(2).all(|w| w[1].0 == w[0].0 + 8), "batches follow each other");
    assert!(raw.iter().all(|r| r.1.len() == 8 * 9));
    assert!((123..=126).contains(&raw.len()), "{} batches", raw.len());
    assert_eq!(session.damaged(), 0);
}
