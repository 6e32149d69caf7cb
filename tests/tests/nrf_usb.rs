//! Tests the frames over USB: enumeration, both directions, a reconnected cable, and the 1200 baud touch.
#![cfg(feature = "nrf")]

use shared_proto::frame::{BOARD_FRAME_MAX, Decoder, encode_host};
use shared_proto::message::{BoardMessage, HostMessage};
use tests::nrf::lsm9ds1::Still;
use tests::nrf::session::RightRig;
use tests::nrf::usb_host::UsbHost;

/// Runs in steps of a millisecond until the host has no more requests.
fn settle(session: &mut RightRig, host: &mut UsbHost) {
    for _ in 0..500 {
        session.run_ms(1);
        host.step(&mut session.board);
        if host.is_ready() || session.board.in_bootloader {
            return;
        }
    }
    panic!("no serial port after half a second: {host:?}");
}

fn plug_in(session: &mut RightRig) -> UsbHost {
    let mut host = UsbHost::default();
    host.plug_in(&mut session.board);
    settle(session, &mut host);
    host
}

fn messages(session: &mut RightRig, host: &mut UsbHost) -> (usize, usize) {
    let bytes = host.read(&mut session.board);
    let mut decoder = Decoder::<BOARD_FRAME_MAX>::new();
    let (mut states, mut hellos) = (0, 0);
    for byte in bytes {
        match decoder.push_board(byte) {
            Some(BoardMessage::Right(_)) => states += 1,
            Some(BoardMessage::Hello(_)) => hellos += 1,
            _ => {}
        }
    }
    assert_eq!(decoder.counters().damaged(), 0);
    (states, hellos)
}

#[test]
fn the_serial_port_enumerates_answers_and_survives_a_pulled_cable() {
    let mut session = RightRig::uart(Box::new(Still));
    session.run_ms(500);
    let mut host = plug_in(&mut session);
    for round in 0..2 {
        let mut buffer = [0; 256];
        let request = encode_host(&HostMessage::HelloRequest, &mut buffer).unwrap().to_vec();
        host.write(&mut session.board, &request);
        session.run_ms(2000);
        let (states, hellos) = messages(&mut session, &mut host);
        println!("round {round}: {states} states and {hellos} hello in 2 s over USB");
        assert!((24..=26).contains(&states) && hellos == 1);
        if round == 0 {
            host.unplug(&mut session.board);
            session.run_ms(500);
            host = plug_in(&mut session);
            host.read(&mut session.board);
        }
    }
}

#[test]
fn a_laptop_that_stops_reading_gets_fresh_states_when_it_reads_again() {
    let mut session = RightRig::uart(Box::new(Still));
    session.run_ms(500);
    let mut host = plug_in(&mut session);
    session.run_ms(500);
    session.board.soc().usb.host_reads = false;
    session.run_ms(3000);
    host.read(&mut session.board);
    session.board.soc().usb.host_reads = true;
    session.run_ms(2000);
    let bytes = host.read(&mut session.board);
    let mut decoder = Decoder::<BOARD_FRAME_MAX>::new();
    let mut times = Vec::new();
    for byte in bytes {
        if let Some(BoardMessage::Right(r)) = decoder.push_board(byte) {
            times.push(r.board_time_ms);
        }
    }
    // Only data that was already in the controller may be old.
    let fresh = session.heard.states.iter().rev().nth(26).unwrap().board_time_ms;
    let old = times.iter().filter(|&&t| t < fresh).count();
    println!("{} states after a pause of 3 s, {old} of them old", times.len());
    assert!(times.len() > 20 && old <= 1);
}

#[test]
fn a_touch_at_1200_baud_returns_to_the_bootloader_which_has_all_the_time_it_needs() {
    let mut session = RightRig::uart(Box::new(Still));
    session.run_ms(500);
    let mut host = plug_in(&mut session);
    assert!(!session.board.in_bootloader);
    host.touch();
    // The watchdog itself resets the board, and is therefore off afterwards.
    for _ in 0..3000 {
        session.run_ms(1);
        host.step(&mut session.board);
        if session.board.in_bootloader {
            break;
        }
    }
    assert!(session.board.in_bootloader);
    // An upload takes 6 s. A running watchdog would interrupt it and start an incomplete image.
    session.run_ms(30_000);
    assert!(session.board.in_bootloader, "resets {:?}", session.board.resets);
    session.board.press_reset();
    session.run_ms(500);
    assert!(!session.board.in_bootloader, "a press of reset starts the image");
}

#[test]
fn two_boards_at_one_laptop_differ_by_the_chips_own_number() {
    let mut session = RightRig::uart(Box::new(Still));
    session.run_ms(500);
    let host = plug_in(&mut session);
    assert_eq!(host.serial_number.as_deref(), Some("9ABCDEF012345678"));
}

#[test]
fn behind_s140_a_cable_attaches_though_ready_is_told_before_detected() {
    let mut session = RightRig::ble(Box::new(Still));
    session.run_ms(1000);
    // The processor is stopped while the cable is connected, so both events are pending afterwards.
    let soc = session.board.soc();
    soc.nvmc.busy_until = soc.now + tests::nrf::time::ms(10);
    let mut host = plug_in(&mut session);
    session.run_ms(1000);
    host.read(&mut session.board);
    session.run_ms(2000);
    assert!((24..=26).contains(&messages(&mut session, &mut host).0));
}

#[test]
fn the_converter_and_the_cache_are_on_in_both_images() {
    for mut session in [RightRig::uart(Box::new(Still)), RightRig::ble(Box::new(Still))] {
        session.run_ms(500);
        let soc = session.board.soc();
        assert!(soc.power.converter && soc.nvmc.cache);
    }
}

#[test]
fn behind_s140_the_serial_line_runs_only_while_the_cable_is_in() {
    let mut session = RightRig::ble(Box::new(Still));
    session.run_ms(3000);
    assert!(!session.board.soc().uart.is_receiving(), "a receiver keeps the fast clock on");
    assert_eq!(session.uart.heard.states.len(), 0);
    let mut host = plug_in(&mut session);
    session.run_ms(2000);
    assert!(session.uart.heard.states.len() > 20);
    host.unplug(&mut session.board);
    session.run_ms(200);
    let before = session.uart.heard.states.len();
    session.run_ms(2000);
    assert!(!session.board.soc().uart.is_receiving());
    assert_eq!(session.uart.heard.states.len(), before);
}
