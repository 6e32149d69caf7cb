//! The same frames over the USB cable: enumeration, both directions, a cable pulled and put back, the touch.
#![cfg(feature = "nrf")]

use shared_proto::frame::{BOARD_FRAME_MAX, Decoder, encode_host};
use shared_proto::message::{BoardMessage, HostMessage};
use tests::nrf::lsm9ds1::Still;
use tests::nrf::session::Session;
use tests::nrf::usbd::Reply;

/// Bulk endpoints of the serial port, found in the configuration descriptor as a host does.
struct Port {
    input: usize,
    output: usize,
}

fn control(session: &mut Session, setup: [u8; 8], data: &[u8]) -> Vec<u8> {
    let soc = session.board.soc();
    soc.usb.control(setup, data, soc.now);
    soc.settle();
    session.run_ms(20);
    let replies = session.board.soc().usb.take_replies();
    match replies.as_slice() {
        [Reply::Done(data)] => data.clone(),
        other => panic!("{setup:x?}: {other:?}"),
    }
}

fn plug_in(session: &mut Session) -> Port {
    let soc = session.board.soc();
    soc.usb.plugged = true;
    soc.usb.host_reads = true;
    soc.power.set_vbus(true, soc.now);
    soc.settle();
    assert!(
        session.run_until_that(500, |s| s.board.soc().usb.is_attached()),
        "the device does not show itself"
    );
    session.run_ms(10);
    let device = control(session, [0x80, 6, 0, 1, 0, 0, 18, 0], &[]);
    assert_eq!(device.len(), 18);
    assert_eq!(device[8..12], [0x41, 0x23, 0x5A, 0x80], "Arduino's ids");
    control(session, [0x00, 5, 7, 0, 0, 0, 0, 0], &[]);
    let head = control(session, [0x80, 6, 0, 2, 0, 0, 9, 0], &[]);
    let total = head[2];
    let all = control(session, [0x80, 6, 0, 2, 0, 0, total, 0], &[]);
    assert_eq!(all.len(), usize::from(total));
    let mut port = Port { input: 0, output: 0 };
    let mut at = 0;
    while at < all.len() {
        // Bulk endpoint descriptors.
        if all[at + 1] == 5 && all[at + 3] == 2 {
            let number = usize::from(all[at + 2] & 0xF);
            if all[at + 2] & 0x80 != 0 { port.input = number } else { port.output = number }
        }
        at += usize::from(all[at]);
    }
    assert!(port.input != 0 && port.output != 0);
    control(session, [0x00, 9, 1, 0, 0, 0, 0, 0], &[]);
    port
}

fn line(session: &mut Session, baud: u32, dtr: bool) {
    let mut coding = baud.to_le_bytes().to_vec();
    coding.extend([0, 0, 8]);
    control(session, [0x21, 0x20, 0, 0, 0, 0, 7, 0], &coding);
    control(session, [0x21, 0x22, u8::from(dtr), 0, 0, 0, 0, 0], &[]);
}

fn messages(session: &mut Session, port: &Port) -> (usize, usize) {
    let bytes = std::mem::take(&mut session.board.soc().usb.received[port.input]);
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
    let port = plug_in(&mut session);
    line(&mut session, 115_200, true);
    for round in 0..2 {
        let mut buffer = [0; 256];
        let request = encode_host(&HostMessage::HelloRequest, &mut buffer).unwrap().to_vec();
        session.board.soc().usb.send(port.output, &request);
        session.board.soc().settle();
        session.run_ms(2000);
        let (states, hellos) = messages(&mut session, &port);
        println!("round {round}: {states} states and {hellos} hello in 2 s over USB");
        assert!((24..=26).contains(&states) && hellos == 1);
        if round == 0 {
            let soc = session.board.soc();
            soc.usb.unplug();
            soc.power.set_vbus(false, soc.now);
            soc.settle();
            session.run_ms(500);
            plug_in(&mut session);
            line(&mut session, 115_200, true);
            session.board.soc().usb.received = Default::default();
        }
    }
}

#[test]
fn a_laptop_that_stops_reading_gets_fresh_states_when_it_reads_again() {
    let mut session = Session::uart(Box::new(Still));
    session.run_ms(500);
    let port = plug_in(&mut session);
    line(&mut session, 115_200, true);
    session.run_ms(500);
    session.board.soc().usb.host_reads = false;
    session.run_ms(3000);
    session.board.soc().usb.received = Default::default();
    session.board.soc().usb.host_reads = true;
    session.run_ms(2000);
    let bytes = session.board.soc().usb.received[port.input].clone();
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
    plug_in(&mut session);
    line(&mut session, 1200, true);
    assert!(!session.board.in_bootloader);
    let soc = session.board.soc();
    soc.usb.control([0x21, 0x22, 0, 0, 0, 0, 0, 0], &[], soc.now);
    soc.settle();
    session.run_ms(500);
    assert!(session.board.in_bootloader);
}
