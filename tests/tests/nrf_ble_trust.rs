//! Tests that only a bonded laptop can change the board over Bluetooth, and that models and bonds survive a restart.
#![cfg(feature = "nrf")]

use shared_dsp::right::kind::FeatureKind;
use shared_dsp::right::network::{Model, crc32};
use shared_proto::message::{AckResult, Bytes, HostMessage, MODEL_CHUNK_MAX, Mode};
use tests::nrf::ble_host::BleHost;
use tests::nrf::lsm9ds1::Still;
use tests::nrf::session::RightRig;
use tests::nrf::softdevice::central::{Command, Happening};
use tests::nrf::transfer::{announce, begin, model_id, random_model};

const BOND_PAGE: usize = 0xD7000;
/// ATT error "insufficient authentication".
const REFUSED: u8 = 5;

/// Runs a laptop that pairs without bonding, or does not pair.
fn stranger(pairs: bool) -> RightRig {
    let mut session = RightRig::ble(Box::new(Still));
    let mut host = BleHost::default();
    (host.pairs, host.bonds) = (pairs, false);
    session.ble = Some(host);
    session.wait_until_ready();
    session
}

fn restart(session: &mut RightRig) {
    session.run_ms(500);
    session.board.soc().nvic.reset_wanted = true;
    // The laptop notices that the board has disappeared, and then finds it again.
    session.run_ms(2500);
    session.wait_until_ready();
}

#[test]
fn without_keys_states_are_read_but_writes_are_refused() {
    let mut session = stranger(false);
    session.board.softdevice().central.order([Command::Write(vec![0, 1, 2]), Command::WriteCommand(vec![0])]);
    session.run_ms(2000);
    assert!(session.heard.states.len() > 20);
    let log = session.log();
    assert!(log.contains(&Happening::Written(Err(REFUSED))), "{log:?}");
    assert_eq!(session.heard.statuses.last().unwrap().bad_frames, 0, "nothing came through");
    // The laptop bonds, and may then change the board.
    session.board.softdevice().central.order([Command::Pair { bond: true }, Command::Write(vec![0])]);
    session.run_ms(1000);
    assert_eq!(session.log().last(), Some(&Happening::Written(Ok(()))));
    let answer = session.ask(3, &HostMessage::SetMode { request: 3, mode: Mode::Idle }).unwrap();
    assert_eq!(answer.result, AckResult::Ok);
}

#[test]
fn whoever_does_not_bond_within_ten_seconds_is_hung_up_on() {
    for pairs in [false, true] {
        let mut session = stranger(pairs);
        let hung_up = |session: &mut RightRig| {
            session.log().iter().any(|what| matches!(what, Happening::Disconnected(_)))
        };
        // The connection is ready about one second after the link is established.
        session.run_ms(6000);
        assert!(!hung_up(&mut session), "pairs: {pairs}");
        session.run_ms(5000);
        assert!(hung_up(&mut session), "pairs: {pairs}: {:?}", session.log());
    }
    // The owner's bond is kept.
    let mut session = RightRig::ble_ready();
    session.run_ms(25_000);
    assert!(!session.log().iter().any(|what| matches!(what, Happening::Disconnected(_))));
}

#[test]
fn a_laptop_that_pairs_without_keeping_keys_changes_nothing() {
    let mut session = stranger(true);
    assert!(session.log().contains(&Happening::Paired { bonded: false }));
    let answer = session.ask(3, &HostMessage::SetMode { request: 3, mode: Mode::Idle }).unwrap();
    assert_eq!(answer.result, AckResult::NotBonded);
    let blob = random_model(FeatureKind::Raw, &[20, 10, 5], 3);
    let model = Model::parse(&blob).unwrap();
    assert_eq!(announce(&mut session, begin(&blob, &model)), AckResult::NotBonded);
    assert_eq!(session.board.soc().nvmc.erased, 0);
    // The board replies to requests that change nothing.
    model_id(&mut session);
}

#[test]
fn a_bond_outlives_a_restart_and_later_nobody_else_takes_its_place() {
    let mut session = RightRig::ble_ready();
    session.run_ms(1000);
    assert_eq!(session.board.soc().flash[BOND_PAGE..BOND_PAGE + 4], *b"BMB2", "in flash");
    restart(&mut session);
    let after = session.log();
    assert_eq!(after.iter().filter(|h| matches!(h, Happening::Paired { .. })).count(), 1, "{after:?}");
    assert!(after.contains(&Happening::Encrypted) && !after.contains(&Happening::KeyMissing));
    let answer = session.ask(3, &HostMessage::SetMode { request: 3, mode: Mode::Classify }).unwrap();
    assert_eq!(answer.result, AckResult::Ok);

    // A bonded laptop does not need to subscribe again.
    session.ble = None;
    session.board.softdevice().central.order([Command::Disconnect]);
    session.run_ms(200);
    session.board.softdevice().central.order([Command::Encrypt]);
    let notified = session.board.softdevice().central.notified.len();
    session.run_ms(2000);
    assert!(session.board.softdevice().central.notified.len() > notified + 15, "notifies by itself");

    // After two minutes, another laptop's pairing creates no bond.
    // Without its sensor the board sleeps most of this time.
    session.board.soc().bus.unplugged = true;
    session.run_ms(120_000);
    session.board.soc().bus.unplugged = false;
    session.board.softdevice().central.order([Command::Disconnect]);
    session.run_ms(200);
    let kept = session.board.softdevice().central.bond.take();
    session.board.softdevice().central.order([Command::Pair { bond: true }]);
    session.run_ms(1000);
    assert_eq!(session.log().last(), Some(&Happening::Paired { bonded: false }));
    session.board.softdevice().central.order([Command::Disconnect]);
    session.run_ms(200);
    session.board.softdevice().central.bond = kept;
    session.board.softdevice().central.order([Command::Encrypt]);
    session.run_ms(1000);
    let last = session.log().pop();
    assert_eq!(last, Some(Happening::Encrypted), "the owner's keys still work");
}

#[test]
fn a_board_that_has_lost_its_keys_says_so_and_pairs_anew() {
    let mut session = RightRig::ble_ready();
    session.run_ms(500);
    session.board.soc().flash[BOND_PAGE..BOND_PAGE + 4096].fill(0xFF);
    restart(&mut session);
    session.run_ms(500);
    let log = session.log();
    let missing = log.iter().position(|h| *h == Happening::KeyMissing).expect("no key");
    assert!(log[missing..].contains(&Happening::Paired { bonded: true }), "{log:?}");
    let answer = session.ask(3, &HostMessage::SetMode { request: 3, mode: Mode::Classify }).unwrap();
    assert_eq!(answer.result, AckResult::Ok);
}

#[test]
fn random_bytes_are_counted_and_change_nothing() {
    let mut session = RightRig::ble_ready();
    let before = model_id(&mut session);
    session.run_ms(1000);
    let erased = session.board.soc().nvmc.erased;
    let mut random = fastrand::Rng::with_seed(140);
    // The lengths include full packets with the maximum of 244 bytes.
    for len in [1, 20, 100, 238, 239, 240, 243, 244].into_iter().cycle().take(400) {
        let bytes = std::iter::repeat_with(|| random.u8(..)).take(len).collect();
        session.board.softdevice().central.order([Command::WriteCommand(bytes)]);
        session.run_ms(5);
    }
    session.run_ms(3000);
    let status = session.heard.statuses.last().unwrap();
    println!("{} damaged frames counted in 400 random writes", status.bad_frames);
    assert!(status.bad_frames > 100);
    assert_eq!(status.mode, Mode::Classify);
    assert_eq!(status.dropped_samples, session.heard.statuses[0].dropped_samples);
    assert_eq!(session.board.soc().nvmc.erased, erased);
    assert_eq!(session.board.resets, [4], "no panic");
    assert!(session.heard.states.iter().all(|s| s.events == 0));
    session.board.softdevice().central.order([Command::WriteCommand(vec![0])]);
    assert_eq!(model_id(&mut session), before);
}

#[test]
fn a_model_sent_over_bluetooth_is_used_after_a_restart_though_flash_and_link_fail_on_the_way() {
    let mut session = RightRig::ble_ready();
    session.run_ms(1000);
    let bundled = model_id(&mut session);
    let blob = random_model(FeatureKind::Raw, &[20, 10, 5], 1);
    let model = Model::parse(&blob).unwrap();
    session.board.softdevice().flash_refusals = 2;
    let from = session.board.now();
    assert_eq!(announce(&mut session, begin(&blob, &model)), AckResult::Ok);
    for (i, data) in blob.chunks(MODEL_CHUNK_MAX).enumerate() {
        let offset = (i * MODEL_CHUNK_MAX) as u32;
        if i == 20 {
            session.board.softdevice().flash_refusals = 1;
        }
        if i == 30 {
            // The link breaks, and the transfer continues over the next link.
            session.board.softdevice().central.order([Command::Disconnect]);
            session.run_ms(300);
            session.wait_until_ready();
        }
        let request = 100 + i as u16;
        let answer = || HostMessage::ModelChunk { request, offset, data: Bytes(data) };
        let mut ack = session.ask(request, &answer());
        if ack.is_none() {
            // The flash operation was repeated, so the reply is late.
            session.run_ms(300);
            ack = session.heard.acks.iter().rev().find(|a| a.request == request).copied();
        }
        assert_eq!(ack.map(|a| (a.result, a.next_offset)), Some((AckResult::Ok, offset + data.len() as u32)));
    }
    let commit = HostMessage::ModelCommit { request: 9, crc32: crc32(&blob) };
    assert_eq!(session.ask(9, &commit).unwrap().result, AckResult::Ok);
    let seconds = session.board.now() - from;
    println!("{} bytes of model in {:.1} s over Bluetooth", blob.len(), seconds as f64 / 64e6);
    assert!(session.board.softdevice().calls[&41] > 20, "written through S140");
    assert_eq!(model_id(&mut session), bundled, "until the restart");
    restart(&mut session);
    assert_eq!(model_id(&mut session), crc32(&blob));
    let worst = session.heard.statuses.iter().map(|s| s.dropped_samples).max();
    println!("dropped samples so far: {worst:?}");
}

/// S140 requires an authenticated packet every 480 s.
/// Without such a packet, nrf-softdevice panics if the laptop does not support LE Ping.
#[test]
fn a_laptop_that_only_listens_and_whose_radio_knows_no_ping_does_not_restart_the_board() {
    let mut session = RightRig::ble_ready();
    session.board.softdevice().central.answers_radio_pings = false;
    session.ask(3, &HostMessage::SetMode { request: 3, mode: Mode::Idle }).expect("an answer");
    // Without its sensor the board sleeps most of the time.
    session.board.soc().bus.unplugged = true;
    session.run_ms(500_000);
    assert_eq!(session.board.resets, [4], "no panic");
    let log = session.log();
    assert!(!log.iter().any(|h| matches!(h, Happening::Disconnected(_))), "{log:?}");
    // The board sends a request after every two minutes of silence.
    let asked = log.iter().filter(|h| matches!(h, Happening::AskedFor { .. })).count();
    assert!((4..=6).contains(&asked), "{asked} times");
    assert!(session.ask(4, &HostMessage::SetMode { request: 4, mode: Mode::Classify }).is_some());
}
