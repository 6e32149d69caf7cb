//! Tests the image with the SoftDevice S140: it boots, advertises, and sends the same data over Bluetooth and UART.
#![cfg(feature = "nrf")]

use models::synth::{self, Motion, Segment};
use nano33_sensor::lsm9ds1::Config;
use shared_dsp::right::RightHand;
use shared_dsp::right::decision::DecisionConfig;
use shared_dsp::right::network::Model;
use shared_proto::frame::{BOARD_FRAME_MAX, Decoder, HOST_FRAME_MAX, encode_host};
use shared_proto::message::{BoardMessage, HostMessage, Mode};
use tests::nrf::lsm9ds1::{Replay, Still};
use tests::nrf::session::RightRig;
use tests::nrf::softdevice::abi::reason;
use tests::nrf::softdevice::central::{Command, Happening};
use tests::nrf::time::{HZ, ms};
use tests::nrf::usb_host::UsbHost;

const SERVICE: u128 = 0xb1a4_0001_6d61_4e75_a1b2_5c3d_9e7f_0a33;
const ADVERTISED_NAME: u8 = 9;
const ADVERTISED_SERVICES: u8 = 7;

#[test]
fn it_boots_within_s140s_rules_and_advertises_its_name_and_service() {
    let mut session = RightRig::ble(Box::new(Still));
    session.board.softdevice().central.connects = false;
    session.run_ms(1000);
    let softdevice = session.board.softdevice();
    let (wanted, given) = softdevice.ram();
    println!("RAM: S140 wants {wanted} bytes (estimate), the image leaves {given}");
    println!("calls by number: {:?}", softdevice.calls);
    assert!(softdevice.is_enabled() && wanted > 0 && wanted <= given);
    let heard = softdevice.central.heard.clone().expect("an advertisement");
    assert_eq!(heard.part(ADVERTISED_NAME), Some(&b"bimanual-right"[..]));
    assert_eq!(heard.part(ADVERTISED_SERVICES), Some(&SERVICE.to_le_bytes()[..]));
    assert_eq!(softdevice.discover().0, [SERVICE]);
    // The board sends an advertisement every 30 to 40 ms, starting after about 10 ms.
    let count = softdevice.central.advertisements;
    println!("{count} advertisements in the first second");
    assert!((24..=34).contains(&count));
    // The board restarts only once, because the first start configures the reset pin.
    assert_eq!(session.board.resets, [4]);
}

#[test]
fn it_asks_for_7_5_to_15_ms_and_for_15_ms_where_that_is_refused() {
    let mut session = RightRig::ble_ready();
    session.run_ms(500);
    let asked = |log: &[Happening]| -> Vec<(u16, u16, bool)> {
        log.iter()
            .filter_map(|h| match h {
                Happening::AskedFor { min, max, granted, .. } => Some((*min, *max, *granted)),
                _ => None,
            })
            .collect()
    };
    let linux = session.log();
    assert_eq!(asked(&linux), [(6, 12, true)]);
    assert!(linux.contains(&Happening::Interval(6)), "7.5 ms");
    assert!(linux.contains(&Happening::Mtu(247)) && linux.contains(&Happening::DataLength(251)));

    for (picky, expected) in [(13, vec![(6, 12, false), (12, 12, false)]), (12, vec![(6, 12, true)])] {
        let mut session = RightRig::ble(Box::new(Still));
        session.board.softdevice().central.shortest_interval = picky;
        session.run_ms(12_000);
        let log = session.log();
        assert_eq!(asked(&log), expected);
        assert!(session.heard.states.len() > 100, "states flow at any interval: {log:?}");
    }
}

/// A simulated wearer who makes every gesture once.
fn wearer() -> (Replay, u64) {
    let mut script = vec![Segment::new(Motion::IDLE, 2.0)];
    for gesture in Motion::GESTURES {
        script.push(Segment::new(gesture, 3.0));
        script.push(Segment::new(Motion::IDLE, 1.0));
    }
    let recording = synth::session(&synth::Wearer::evaluation(21, 1), 0, &script);
    let rows: Vec<[f64; 9]> =
        recording.samples().map(|s| std::array::from_fn(|axis| f64::from(s[axis]))).collect();
    let seconds = rows.len() as u64 / 100 + 2;
    (Replay { rows, interval: 0.01, start: 1.0 }, seconds)
}

#[test]
fn notifications_carry_the_frames_of_the_uart_and_the_laptops_own_labels() {
    let (replay, seconds) = wearer();
    let mut session = RightRig::ble(Box::new(replay));
    session.charge();
    let tap = session.board.tap("bimanual_sample", 18);
    session.wait_until_ready();
    session.send(&HostMessage::HelloRequest);
    let (mut awake, mut from) = (0, 0);
    for second in 0..seconds {
        session.run_ms(1000);
        if second == 3 {
            (awake, from) = (session.board.awake(), session.board.now());
        }
    }
    let own = session.board.softdevice().own_cycles;
    let share = (session.board.awake() - awake) as f64 / (session.board.now() - from) as f64;
    assert_eq!(session.heard.hellos.len(), 1);
    assert_eq!(session.damaged(), 0);

    // The states over UART and over the radio must be identical.
    let (wire, air) = (&session.uart.heard.states, &session.heard.states);
    let mut delays = Vec::new();
    let mut wire_after = wire.iter().skip_while(|w| w.sequence != air[0].sequence);
    for state in air {
        let twin = wire_after.next().expect("as many on the wire");
        assert_eq!((twin.sequence, &twin.scores), (state.sequence, &state.scores));
        assert_eq!((twin.events, twin.label, twin.health), (state.events, state.label, state.health));
        assert_eq!(twin.event_window_end_ms, state.event_window_end_ms);
        delays.push(state.at as i64 - twin.at as i64);
    }
    assert!(air.len() as u64 > (seconds - 2) * 12, "{} states", air.len());

    // The laptop's own calculation from the board's samples must agree too.
    let blob = models::bundled::blob().expect("the bundled model is intact");
    let mut hand = RightHand::<9>::new(Model::parse(&blob).unwrap(), DecisionConfig::default()).unwrap();
    let scale = Config::default().scale();
    let mut hops = 0;
    let mut events = Vec::new();
    for call in session.board.tapped(tap) {
        let values = std::array::from_fn(|axis| {
            let count = i16::from_le_bytes([call.bytes[2 * axis], call.bytes[2 * axis + 1]]);
            f32::from(count) * scale[axis / 3]
        });
        let Some(output) = hand.push(&values, call.registers[2]) else { continue };
        let Some(state) = session.heard.states.iter().find(|s| s.board_time_ms == output.window_end_ms)
        else {
            continue;
        };
        assert_eq!(state.scores, output.score_bytes()[..output.scores().len()]);
        assert_eq!(
            (state.events, state.label, state.confidence),
            (output.events, output.label, output.confidence)
        );
        if events.last() != Some(&(output.events, output.label)) && output.events > 0 {
            events.push((output.events, output.label));
        }
        hops += 1;
    }
    println!("{hops} hops over Bluetooth equal the laptop's and the UART's; events {events:?}");
    delays.sort_unstable();
    println!(
        "later than the UART's by {:.1} ms median, {:.1} ms worst",
        delays[delays.len() / 2] as f64 / ms(1) as f64,
        delays[delays.len() - 1] as f64 / ms(1) as f64
    );
    println!(
        "awake {:.2} % while classifying over Bluetooth, of which S140 {:.2} % (typical times of its specification)",
        100.0 * share,
        100.0 * own as f64 / session.board.now() as f64
    );
    // According to the nRF52840 product specification, the processor draws 52 uA/MHz awake.
    // This value is for code in flash at 3 V with the DC/DC converter.
    // Asleep with RAM and RTC, the processor draws 3.16 uA.
    println!(
        "processor current implied {:.0} uA (radio and sensor come on top)",
        share * 0.052 * 64e3 + 3.16
    );
    assert!(hops > 200 && events.len() == 6);
    assert!(share <= 0.05, "awake {share}");
}

#[test]
fn a_link_that_stalls_costs_old_states_not_new_ones_and_nothing_else_waits() {
    let mut session = RightRig::ble_ready();
    session.charge();
    session.run_ms(3000);
    let dropped = session.heard.statuses.last().unwrap().dropped_samples;
    // The interruption is shorter than the supervision timeout, so the link survives.
    session.board.softdevice().central.in_range = false;
    let (before, wire_before) = (session.heard.states.len(), session.uart.heard.states.len());
    session.run_ms(1700);
    assert_eq!(session.heard.states.len(), before, "nothing passes");
    let wire = session.uart.heard.states.len() - wire_before;
    assert!((20..=22).contains(&wire), "{wire} states on the wire meanwhile");
    let newest = session.uart.heard.states.last().unwrap().sequence;
    session.board.softdevice().central.in_range = true;
    let back = session.board.now();
    assert!(session.run_until_that(200, |s| s.heard.states.iter().any(|r| r.sequence == newest)));
    let waited = (session.board.now() - back) / ms(1);
    let old = session.heard.states.len() - before;
    println!(
        "after 1.7 s of silence the newest state is there in {waited} ms, behind {} older ones",
        old - 1
    );
    session.run_ms(2000);
    assert_eq!(session.damaged(), 0);
    assert_eq!(session.heard.statuses.last().unwrap().dropped_samples, dropped);
    let sequences: Vec<u16> = session.heard.states.iter().map(|s| s.sequence).collect();
    assert!(sequences.is_sorted(), "in order");
    assert!(session.log().iter().all(|h| !matches!(h, Happening::Disconnected(_))));
    assert!(old <= 15 && waited <= 100);
}

#[test]
fn it_advertises_again_after_every_kind_of_disconnect_and_the_laptop_is_back_by_itself() {
    let mut session = RightRig::ble_ready();
    // Meanwhile the keys are written to flash, which delays the radio.
    session.run_ms(500);
    session.board.softdevice().central.order([Command::Disconnect]);
    session.run_ms(100);
    session.wait_until_ready();
    // The laptop is out of range for longer than the supervision timeout.
    session.board.softdevice().central.in_range = false;
    session.run_ms(3000);
    assert!(session.board.softdevice().is_advertising());
    let states = session.heard.states.len();
    session.board.softdevice().central.in_range = true;
    session.run_ms(2000);
    assert!(session.heard.states.len() > states + 15, "{:?}", session.log());
    let log = session.log();
    let lost = log.iter().filter_map(|h| if let Happening::Disconnected(r) = h { Some(*r) } else { None });
    assert_eq!(lost.collect::<Vec<_>>(), [reason::LOCAL_HOST, reason::TIMEOUT]);
    assert_eq!(log.iter().filter(|h| matches!(h, Happening::Paired { .. })).count(), 1, "paired once");
    assert_eq!(log.iter().filter(|h| **h == Happening::Encrypted).count(), 2, "kept keys");
    assert_eq!(session.damaged(), 0);
}

#[test]
fn usb_and_uart_go_on_while_s140_owns_clock_and_power() {
    let mut session = RightRig::ble_ready();
    let mut usb = UsbHost::default();
    usb.plug_in(&mut session.board);
    let mut bytes = Vec::new();
    let mut step = |session: &mut RightRig, usb: &mut UsbHost| {
        session.run_ms(1);
        usb.step(&mut session.board);
        bytes.extend(usb.read(&mut session.board));
    };
    while !usb.is_ready() {
        step(&mut session, &mut usb);
        assert!(session.board.now() < 6 * HZ, "no serial port: {usb:?}");
    }
    assert!(session.board.soc().power.crystal, "USB needs the crystal");
    let mut buffer = [0; HOST_FRAME_MAX];
    usb.write(&mut session.board, encode_host(&HostMessage::HelloRequest, &mut buffer).unwrap());
    let (air, wire) = (session.heard.states.len(), session.uart.heard.states.len());
    for _ in 0..2000 {
        step(&mut session, &mut usb);
    }
    let (air, wire) = (session.heard.states.len() - air, session.uart.heard.states.len() - wire);
    // The cable is disconnected and reconnected.
    usb.unplug(&mut session.board);
    for _ in 0..300 {
        step(&mut session, &mut usb);
    }
    usb.plug_in(&mut session.board);
    for _ in 0..1000 {
        step(&mut session, &mut usb);
    }
    assert!(usb.is_ready());
    let mut decoder = Decoder::<BOARD_FRAME_MAX>::new();
    let (mut states, mut hellos) = (0, 0);
    for byte in bytes {
        match decoder.push_board(byte) {
            Some(BoardMessage::Right(_)) => states += 1,
            Some(BoardMessage::Hello(_)) => hellos += 1,
            _ => {}
        }
    }
    println!("in 2 s {air} states over the air and {wire} on the wire, beside them {states} over USB in 3 s");
    assert!((24..=26).contains(&air) && (24..=26).contains(&wire) && states >= 30 && hellos == 1);
}

#[test]
fn raw_samples_arrive_without_a_gap() {
    let mut session = RightRig::ble_ready();
    assert!(session.ask(5, &HostMessage::SetMode { request: 5, mode: Mode::Record }).is_some());
    session.run_ms(10_000);
    let raw = &session.heard.raw;
    let samples: usize = raw.iter().map(|(_, counts)| counts.len() / 9).sum();
    println!("{samples} raw samples in 10 s over Bluetooth");
    for pair in raw.windows(2) {
        assert_eq!(pair[1].0, pair[0].0 + (pair[0].1.len() / 9) as u32);
    }
    assert!((980..=1010).contains(&samples));
}

/// Returns the numbers of complete and damaged frames in a byte stream.
fn frames(notified: &[(u64, Vec<u8>)]) -> (u32, u32) {
    let mut decoder = Decoder::<BOARD_FRAME_MAX>::new();
    let bytes = notified.iter().flat_map(|(_, bytes)| bytes);
    let whole = bytes.filter(|&&byte| decoder.push(byte).is_some()).count();
    (whole as u32, decoder.counters().damaged())
}

#[test]
fn with_the_smallest_mtu_frames_come_in_pieces_and_whole_and_a_stall_tears_one_at_most() {
    let mut session = RightRig::ble(Box::new(Still));
    session.ble = None;
    session.board.softdevice().central.long_packets = false;
    session.board.softdevice().central.order([Command::Subscribe(true)]);
    session.run_ms(4000);
    let notified = session.board.softdevice().central.notified.clone();
    let longest = notified.iter().map(|(_, bytes)| bytes.len()).max().unwrap();
    let (whole, damaged) = frames(&notified);
    println!("{whole} frames in {} pieces of at most {longest} bytes", notified.len());
    assert_eq!((longest, damaged), (20, 0));
    let seconds = (session.board.now() - notified[0].0) / HZ;
    assert!(u64::from(whole) >= 12 * seconds);

    for _ in 0..4 {
        session.board.softdevice().central.in_range = false;
        session.run_ms(1500);
        session.board.softdevice().central.in_range = true;
        session.run_ms(1000);
    }
    let (_, damaged) = frames(&session.board.softdevice().central.notified);
    println!("{damaged} frames damaged by 4 stalls");
    assert!(damaged <= 4);
}
