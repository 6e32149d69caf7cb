//! The same frames over the USB cable: enumeration, both directions, a cable pulled and put back, the touch.
#![cfg(feature = "nrf")]

use shared_proto::frame::{BOARD_FRAME_MAX, Decoder, encode_host};
use shared_proto::message::{BoardMessage, HostMessage};
use tests::nrf::lsm9ds1::Still;
use tests::nrf::session::Session;
use tests::nrf::usb_host::UsbHost;

/// Steps of a millisecond until the host has nothing left to ask.
fn settle(session: &mut Session, host: &mut UsbHost) {
    for _ in 0..500 {
        session.run_ms(1);
        host.step(&mut session.board);
        if host.is_ready() || session.board.in_bootloader {
            return;
        }
    }
    panic!("no serial port after half a second: {host:?}");
}

fn plug_in(session: &mut Session) -> UsbHost {
    let mut host = UsbHost::default();
    host.plug_in(&mut session.board);
    settle(session, &mut host);
    host
}

fn messages(session: &mut Session, host: &mut UsbHost) -> (usize, usize) {
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
    let mut session = Session::uart(Box::new(Still));
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
    let mut session = Session::uart(Box::new(Still));
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
    // At most what was already in the controller is old.
    let fresh = session.heard.states.iter().rev().nth(26).unwrap().board_time_ms;
    let old = times.iter().filter(|&&t| t < fresh).count();
    println!("{} states after a pause of 3 s, {old} of them old", times.len());
    assert!(times.len() > 20 && old <= 1);
}

#[test]
fn a_touch_at_1200_baud_returns_to_the_bootloader() {
    let mut session = Session::uart(Box::new(Still));
    session.run_ms(500);
    let mut host = plug_in(&mut session);
    assert!(!session.board.in_bootloader);
    host.touch();
    settle(&mut session, &mut host);
    session.run_ms(500);
    assert!(session.board.in_bootloader);
}
