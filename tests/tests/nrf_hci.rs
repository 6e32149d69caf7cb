//! Tests the image that contains Nordic's controller and the host stack `trouble`.
//! Bumble runs on the other side of the radio link.
//! Bumble is Google's Bluetooth stack. It simulates the other controller, the radio link and the laptop.
//! Everything above HCI is the code that users flash.
//!
//! Some parts are modelled and prove nothing about a real radio.
//! The models are the times at which packets pass (`src/nrf/controller/link.rs`), the time slots for flash,
//! the data length and the PHY.
#![cfg(feature = "nrf")]

use serde_json::{Value, json};
use shared_dsp::right::kind::FeatureKind;
use shared_dsp::right::network::{Model, crc32};
use shared_proto::message::{AckResult, Bytes, HostMessage, MODEL_CHUNK_MAX, Mode, Pairing, PairingKind};
use tests::is_full;
use tests::nrf::air_host::{IN, OUT};
use tests::nrf::board::Kind;
use tests::nrf::lsm9ds1::Still;
use tests::nrf::session::RightRig;
use tests::nrf::time::ms;
use tests::nrf::transfer::{announce, begin, model_id, random_model};

const SERVICE: &str = "B1A40001-6D61-4E75-A1B2-5C3D9E7F0A33";
/// The board restarts only once, because its first start configures the reset pin.
const STARTED_ONCE: [u32; 1] = [4];
/// The two pages of flash that store bonds.
const BONDS: std::ops::Range<usize> = 0xD6000..0xD8000;
/// SMP error code: the board requires an authentication that the laptop does not offer.
const AUTHENTICATION_REQUIREMENTS: u64 = 3;
/// SMP error code: the passkeys differ.
const CONFIRM_VALUE_FAILED: u64 = 4;

/// Creates a board that lies still and has started.
fn rig() -> RightRig {
    let mut rig = RightRig::air(Kind::Nano33, Box::new(Still));
    rig.run_ms(700);
    rig
}

/// Creates such a board with a bonded and subscribed laptop, at this connection interval in ms.
fn joined(interval: f64) -> RightRig {
    let mut rig = rig();
    rig.join(interval);
    rig
}

/// Checks the samples that the image has taken since the tap, and returns their number.
/// The numbers of these samples must be consecutive.
/// Their times (in whole ms) must fit the image's grid of 100 Hz.
/// No sample may be missing, and none may occur twice.
fn samples_without_a_gap(rig: &RightRig, tap: usize) -> usize {
    let samples = rig.board.tapped(tap);
    for pair in samples.windows(2) {
        let [before, after] = [&pair[0].registers, &pair[1].registers];
        assert_eq!(after[3], before[3] + 1, "a sample is missing behind {} ms", before[2]);
        assert!((9..=11).contains(&(after[2] - before[2])), "{} ms, then {}", before[2], after[2]);
    }
    let [first, last] = [&samples[0].registers, &samples[samples.len() - 1].registers];
    assert!((last[2] - first[2]).abs_diff(10 * (last[3] - first[3])) <= 1, "{first:?} to {last:?}");
    samples.len()
}

#[test]
fn it_is_found_by_its_name_and_its_service() {
    if !tests::has_linked_image() {
        return;
    }
    let mut rig = rig();
    let heard = rig.get(json!({"do": "scan", "seconds": 1.0}));
    println!("{heard}");
    let boards: Vec<&Value> = heard.as_object().expect("advertisers").values().collect();
    assert_eq!(boards.len(), 1);
    assert_eq!(boards[0]["names"], json!(["bimanual-right"]));
    assert_eq!(boards[0]["services"].to_string().to_uppercase(), format!("[\"{SERVICE}\"]"));
    assert_eq!(rig.board.resets, STARTED_ONCE);
}

#[test]
fn a_laptop_pairs_with_secure_connections_and_hears_a_state_every_hop_while_sampling_keeps_100_hz() {
    if !tests::has_linked_image() {
        return;
    }
    let mut rig = rig();
    let tap = rig.board.tap("bimanual_sample", 0);
    let from = rig.board.now();
    rig.get(json!({"do": "connect", "interval": 30.0}));
    let before = rig.board.instructions();
    let paired = rig.get(json!({"do": "pair"}));
    println!(
        "paired within {} ms, {:.1} million instructions: {paired}",
        (rig.board.now() - from) / ms(1),
        (rig.board.instructions() - before) as f64 / 1e6
    );
    assert_eq!((&paired["encrypted"], &paired["sc"]), (&json!(true), &json!(true)));
    rig.settle_in();
    rig.run_ms(3000);
    // The board has requested the shortest interval, and the settings that make the radio fast.
    let (interval, radio) = (rig.board.controller().interval(), rig.board.controller().radio());
    println!("interval {:.2} ms, radio {radio:?}", interval.unwrap() as f64 / ms(1) as f64);
    assert!(interval.unwrap() <= ms(15));
    assert_eq!(radio, Some((251, true)));
    let states = rig.heard.states.len();
    rig.run_ms(8000);
    let states = &rig.heard.states[states..];
    assert!((99..=101).contains(&states.len()), "{} states in 8 s", states.len());
    assert!(states.windows(2).all(|pair| pair[1].sequence == pair[0].sequence.wrapping_add(1)));
    let samples = samples_without_a_gap(&rig, tap);
    println!("{samples} samples, each 10 ms after the last");
    assert!(samples > 1100);
    assert_eq!((rig.damaged(), &rig.board.resets[..]), (0, &STARTED_ONCE[..]));
    println!("calls: {:?}", rig.board.controller().calls);
}

#[test]
fn legacy_pairing_is_refused() {
    if !tests::has_linked_image() {
        return;
    }
    let mut rig = rig();
    rig.get(json!({"do": "configure", "secure": false}));
    rig.get(json!({"do": "connect", "interval": 15.0}));
    let failed = rig.want(json!({"do": "pair"})).expect_err("legacy pairing");
    println!("{failed}");
    assert_eq!(failed["code"], AUTHENTICATION_REQUIREMENTS);
    assert_eq!(rig.board.resets, STARTED_ONCE);
}

/// Reads a passkey as an owner does who counts the flashes of the light. Red counts 5, green counts 1, and blue is 0.
/// Flashes of one digit follow within 0.4 s, digits after more than 1 s, and the first digit after more than 2 s.
fn passkey_of_the_light(rig: &mut RightRig) -> u64 {
    let (mut digits, mut lit_ms, mut dark_ms) = (Vec::new(), [0; 3], 0);
    for _ in 0..30_000 / 5 {
        rig.run_ms(5);
        let led = rig.board.soc().led();
        match led.iter().position(|&on| on) {
            Some(colour) => {
                lit_ms[colour] += 5;
                // The board's usual flash is shorter.
                if lit_ms[colour] == 100 {
                    if digits.is_empty() || dark_ms > 1000 {
                        digits.push(0);
                    }
                    *digits.last_mut().expect("a digit") += [5, 1, 0][colour];
                    dark_ms = 0;
                }
            }
            None => {
                (lit_ms, dark_ms) = ([0; 3], dark_ms + 5);
                if digits.len() == 6 && dark_ms > 2000 {
                    return digits.iter().fold(0, |number, digit| 10 * number + digit);
                }
            }
        }
    }
    panic!("the light shows {digits:?}")
}

/// Lets a laptop with a keyboard pair, until it asks its owner for the passkey. Returns the number of its order.
fn pair_with_a_keyboard(rig: &mut RightRig) -> u64 {
    rig.get(json!({"do": "configure", "io": "keyboard"}));
    rig.get(json!({"do": "connect", "interval": 15.0}));
    let asked = |rig: &mut RightRig| rig.noticed("asked").iter().filter(|(_, what)| what == "enter").count();
    let before = asked(rig);
    let order = rig.board.order(json!({"do": "pair"}));
    assert!(rig.run_until_that(3000, |rig| asked(rig) > before), "the laptop asks for no passkey");
    order
}

/// As [`pair_with_a_keyboard`], and also returns the passkey that the board sends by cable.
fn pair_with_a_passkey(rig: &mut RightRig) -> (u64, u32) {
    let order = pair_with_a_keyboard(rig);
    rig.run_ms(2000);
    (order, rig.uart.heard.pairings.last().expect("the passkey by cable").passkey)
}

/// Waits until an order is done.
fn outcome(rig: &mut RightRig, order: u64) -> Value {
    for _ in 0..5000 {
        let outcome = rig.board.controller().air().outcome(order).cloned();
        if let Some(outcome) = outcome {
            return outcome;
        }
        rig.run_ms(1);
    }
    panic!("the order takes too long")
}

/// Returns how the link was paired, according to the board.
fn said_paired(rig: &mut RightRig) -> Option<PairingKind> {
    rig.send(&HostMessage::HelloRequest);
    rig.run_ms(300);
    rig.heard.pairings.last().map(|pairing| pairing.kind)
}

#[test]
fn a_laptop_with_a_keyboard_pairs_with_the_passkey_that_the_light_and_the_cable_show() {
    if !tests::has_linked_image() {
        return;
    }
    let mut rig = rig();
    rig.charge();
    let order = pair_with_a_keyboard(&mut rig);
    let shown = passkey_of_the_light(&mut rig);
    let said: Vec<Pairing> = rig.uart.heard.pairings.clone();
    assert!(
        said.len() > 5
            && said.iter().all(|said| *said == Pairing { kind: PairingKind::Passkey, passkey: shown as u32 })
    );
    rig.get(json!({"do": "type", "number": shown}));
    let paired = outcome(&mut rig, order);
    println!("passkey {shown:06} read off the light: {paired}");
    let paired = &paired["done"];
    assert_eq!([&paired["encrypted"], &paired["sc"], &paired["authenticated"]], [&json!(true); 3]);
    rig.settle_in();
    assert_eq!(said_paired(&mut rig), Some(PairingKind::PasskeyTyped));
    // The passkey itself never leaves over the air.
    assert!(rig.heard.pairings.iter().all(|said| said.passkey == 0));
    // The board also remembers this.
    rig.board.soc().nvic.reset_wanted = true;
    rig.run_ms(3000);
    rig.heard.pairings.clear();
    rig.join(15.0);
    assert_eq!(said_paired(&mut rig), Some(PairingKind::PasskeyTyped));
    assert_eq!(rig.board.resets.len(), 2, "no panic");
}

#[test]
fn a_wrong_passkey_is_refused_and_leaves_no_keys() {
    if !tests::has_linked_image() {
        return;
    }
    let mut rig = rig();
    rig.charge();
    let (order, shown) = pair_with_a_passkey(&mut rig);
    rig.get(json!({"do": "type", "number": (shown + 1) % 1_000_000}));
    let failed = outcome(&mut rig, order);
    println!("{failed}");
    assert_eq!(failed["code"], CONFIRM_VALUE_FAILED);
    rig.run_ms(2000);
    assert_eq!(rig.board.soc().flash[BONDS.start..BONDS.start + 4], [0xFF; 4], "no bond in flash");
    // The board shows the passkey no longer.
    rig.uart.heard.pairings.clear();
    rig.run_ms(3000);
    assert!(rig.uart.heard.pairings.is_empty());
    // The next attempt has another passkey, and the right one succeeds.
    if rig.board.controller().is_connected() {
        rig.get(json!({"do": "disconnect"}));
        rig.run_ms(300);
    }
    let (order, next) = pair_with_a_passkey(&mut rig);
    assert_ne!(next, shown);
    rig.get(json!({"do": "type", "number": next}));
    assert_eq!(outcome(&mut rig, order)["done"]["authenticated"], true);
    assert_eq!(rig.board.resets, STARTED_ONCE);
}

/// A stranger can claim the owner's address.
#[test]
fn keys_paired_with_a_passkey_are_not_replaced_by_just_works_and_no_passkey_is_shown_after_the_window() {
    if !tests::has_linked_image() {
        return;
    }
    let mut rig = rig();
    rig.charge();
    let (order, shown) = pair_with_a_passkey(&mut rig);
    rig.get(json!({"do": "type", "number": shown}));
    assert_eq!(outcome(&mut rig, order)["done"]["authenticated"], true);
    rig.run_ms(1000);
    let keys = rig.board.soc().flash[BONDS].to_vec();
    assert_ne!(keys[..4], [0xFF; 4]);
    let again = |rig: &mut RightRig, io: &str| {
        if rig.board.controller().is_connected() {
            rig.get(json!({"do": "disconnect"}));
        }
        rig.run_ms(500);
        rig.get(json!({"do": "forget"}));
        rig.get(json!({"do": "configure", "io": io}));
        rig.get(json!({"do": "connect", "interval": 15.0}));
        rig.uart.heard.pairings.clear();
        rig.board.order(json!({"do": "pair"}));
        rig.run_ms(5000);
        assert!(!rig.board.controller().is_connected(), "{io}: it hangs up");
        assert!(rig.uart.heard.pairings.is_empty(), "{io}: no passkey");
        assert_eq!(rig.board.soc().flash[BONDS], keys, "{io}: the same keys");
    };
    again(&mut rig, "none");
    rig.run_ms(120_000);
    again(&mut rig, "keyboard");
    assert_eq!(rig.board.resets, STARTED_ONCE);
}

#[test]
fn laptops_without_a_keyboard_pair_by_just_works_and_the_board_says_so() {
    if !tests::has_linked_image() {
        return;
    }
    for io in ["none", "display"] {
        let mut rig = rig();
        rig.charge();
        rig.get(json!({"do": "configure", "io": io}));
        rig.get(json!({"do": "connect", "interval": 15.0}));
        let paired = rig.get(json!({"do": "pair"}));
        assert_eq!([&paired["encrypted"], &paired["sc"]], [&json!(true); 2], "{io}");
        rig.settle_in();
        assert_eq!(said_paired(&mut rig), Some(PairingKind::JustWorks), "{io}");
        assert!(rig.uart.heard.pairings.is_empty(), "{io}: no passkey");
    }
}

#[test]
fn without_keys_there_is_nothing_to_hear_and_nothing_to_write() {
    if !tests::has_linked_image() {
        return;
    }
    let mut rig = rig();
    rig.get(json!({"do": "connect", "interval": 15.0}));
    rig.get(json!({"do": "discover"}));
    let refused = rig.want(json!({"do": "write", "uuid": IN, "bytes": "00", "response": true}));
    let deaf = rig.want(json!({"do": "subscribe", "uuid": OUT}));
    println!("write: {refused:?}; subscribe: {deaf:?}");
    // These codes mean insufficient authentication, authorization or encryption.
    let code = refused.expect_err("a write without keys")["code"].as_u64().expect("an ATT error");
    assert!([5, 8, 15].contains(&code), "{code}");
    assert!(deaf.is_err(), "a subscription without keys");
    rig.get(json!({"do": "write", "uuid": IN, "bytes": ["0102", "00"]}));
    rig.run_ms(1000);
    assert!(rig.heard.states.is_empty(), "not a state");
    // The board disconnects a stranger that stays, so that the owner can pair.
    rig.run_ms(32_000);
    assert_eq!(rig.noticed("lost").len(), 1, "hung up");
    rig.join(15.0);
    rig.run_ms(500);
    assert!(!rig.heard.states.is_empty());
    assert_eq!(rig.heard.statuses.last().map_or(0, |status| status.bad_frames), 0, "nothing came through");
}

#[test]
fn keys_that_the_laptop_does_not_keep_give_nothing() {
    if !tests::has_linked_image() {
        return;
    }
    let mut rig = rig();
    rig.get(json!({"do": "configure", "bonds": false}));
    rig.get(json!({"do": "connect", "interval": 15.0}));
    let paired = rig.want(json!({"do": "pair"}));
    println!("{paired:?}");
    rig.run_ms(1000);
    let refused = rig
        .want(json!({"do": "discover"}))
        .and_then(|_| rig.want(json!({"do": "write", "uuid": IN, "bytes": "00", "response": true})));
    println!("{refused:?}");
    assert!(refused.is_err());
    assert!(rig.heard.states.is_empty());
    assert_eq!(rig.board.soc().flash[BONDS.start..BONDS.start + 4], [0xFF; 4], "no bond in flash");
}

#[test]
fn a_model_of_5_kb_arrives_within_5_s_and_runs_after_a_restart() {
    if !tests::has_linked_image() {
        return;
    }
    let mut rig = joined(7.5);
    rig.run_ms(7000);
    // Bumble grants the longest interval that the board requests, but Linux grants the shortest.
    rig.get(json!({"do": "parameters", "interval": 7.5, "latency": 4}));
    rig.run_ms(200);
    assert_eq!(rig.board.controller().interval(), Some(ms(15) / 2));
    let tap = rig.board.tap("bimanual_sample", 0);
    let blob = random_model(FeatureKind::Raw, &[22, 11, 6], 1);
    let model = Model::parse(&blob).unwrap();
    assert!((5000..=5700).contains(&blob.len()), "{} bytes", blob.len());
    let (from, events) = (rig.board.now(), rig.board.controller().events);
    assert_eq!(announce(&mut rig, begin(&blob, &model)), AckResult::Ok);
    let mut offset = 0;
    for (i, data) in blob.chunks(MODEL_CHUNK_MAX).enumerate() {
        let request = 100 + i as u16;
        let ack = rig.ask(request, &HostMessage::ModelChunk { request, offset, data: Bytes(data) });
        offset += data.len() as u32;
        assert_eq!(ack.map(|a| (a.result, a.next_offset)), Some((AckResult::Ok, offset)));
    }
    let commit = HostMessage::ModelCommit { request: 9, crc32: crc32(&blob) };
    assert_eq!(rig.ask(9, &commit).expect("an answer").result, AckResult::Ok);
    let seconds = (rig.board.now() - from) as f64 / 64e6;
    let missed = rig.board.controller().events[1] - events[1];
    println!(
        "{} bytes of model in {seconds:.2} s at 7.5 ms (modelled); {missed} events missed for flash",
        blob.len()
    );
    assert!(seconds < 5.0);
    assert!(rig.noticed("lost").is_empty(), "the link holds while flash is written");
    samples_without_a_gap(&rig, tap);
    rig.board.soc().nvic.reset_wanted = true;
    rig.run_ms(3000);
    rig.join(15.0);
    assert_eq!(model_id(&mut rig), crc32(&blob));
}

#[test]
fn a_bonded_laptop_is_back_with_its_keys_after_a_reset_of_either_side() {
    if !tests::has_linked_image() {
        return;
    }
    let mut rig = joined(15.0);
    rig.run_ms(2000);
    // The board restarts, and the laptop notices this by the silence.
    rig.board.soc().nvic.reset_wanted = true;
    rig.run_ms(3000);
    assert_eq!(rig.noticed("lost").len(), 1);
    assert!(!rig.get(json!({"do": "bonds"})).as_array().expect("names").is_empty());
    rig.join(15.0);
    let answer = rig.ask(3, &HostMessage::SetMode { request: 3, mode: Mode::Classify });
    assert_eq!(answer.expect("an answer").result, AckResult::Ok);
    // The laptop restarts, and the board notices this by the silence.
    rig.get(json!({"do": "restart"}));
    rig.board.controller().in_range = false;
    rig.run_ms(3000);
    rig.board.controller().in_range = true;
    assert!(!rig.board.controller().is_connected());
    rig.join(15.0);
    let answer = rig.ask(4, &HostMessage::SetMode { request: 4, mode: Mode::Classify });
    assert_eq!(answer.expect("an answer").result, AckResult::Ok);
    // A bonded laptop does not need to subscribe again.
    rig.get(json!({"do": "disconnect"}));
    rig.run_ms(300);
    rig.get(json!({"do": "connect", "interval": 15.0}));
    rig.get(json!({"do": "encrypt"}));
    let before = rig.board.controller().passed[1];
    rig.run_ms(2000);
    assert!(rig.board.controller().passed[1] > before + 15 * 20, "notifies by itself");
}

/// The laptop looks for the board as soon as it notices the silence, or as soon as the laptop itself runs again.
/// The duration of a scan and the radio's timing are modelled.
#[test]
fn after_a_reset_of_either_side_states_arrive_again_within_2_s() {
    if !tests::has_linked_image() {
        return;
    }
    let mut rig = joined(15.0);
    rig.wait_for_parameters();
    let from = rig.board.now();
    rig.board.soc().nvic.reset_wanted = true;
    assert!(rig.run_until_that(1500, |rig| !rig.noticed("lost").is_empty()), "the laptop notices nothing");
    let noticed_ms = (rig.board.now() - from) / ms(1);
    let board_ms = rig.return_ms(from);
    println!(
        "states again {board_ms} ms after the board's reset, which is noticed after {noticed_ms} ms (modelled)"
    );
    assert!(board_ms < 2000);

    rig.wait_for_parameters();
    let from = rig.board.now();
    rig.get(json!({"do": "restart"}));
    rig.board.controller().in_range = false;
    assert!(rig.run_until_that(1500, |rig| !rig.board.is_connected()), "the board notices nothing");
    let noticed_ms = (rig.board.now() - from) / ms(1);
    rig.board.controller().in_range = true;
    rig.run_ms(50);
    let laptop_ms = rig.return_ms(from);
    println!(
        "states again {laptop_ms} ms after the laptop's, which is noticed after {noticed_ms} ms (modelled)"
    );
    assert!(laptop_ms < 2000);
}

#[test]
fn when_either_side_has_lost_the_bond_both_pair_anew() {
    if !tests::has_linked_image() {
        return;
    }
    let mut rig = joined(15.0);
    rig.run_ms(2000);
    // The board's flash is blank, and the board reports this.
    // The laptop then forgets its keys and pairs again, as its owner would do.
    rig.board.soc().flash[BONDS].fill(0xFF);
    rig.board.soc().nvic.reset_wanted = true;
    rig.run_ms(3000);
    rig.get(json!({"do": "connect", "interval": 15.0}));
    let missing = rig.want(json!({"do": "encrypt"})).expect_err("no key");
    println!("the board has no key: {missing}");
    rig.get(json!({"do": "forget"}));
    if !rig.board.controller().is_connected() {
        rig.run_ms(500);
        rig.get(json!({"do": "connect", "interval": 15.0}));
    }
    assert_eq!(rig.get(json!({"do": "pair"}))["sc"], true);
    rig.settle_in();
    rig.run_ms(1000);
    assert!(rig.ask(3, &HostMessage::SetMode { request: 3, mode: Mode::Classify }).is_some());
    // The laptop has lost its keys. It pairs again within the time in which laptops may bond.
    rig.get(json!({"do": "disconnect"}));
    rig.get(json!({"do": "forget"}));
    rig.run_ms(300);
    rig.join(15.0);
    rig.run_ms(500);
    let answer = rig.ask(4, &HostMessage::SetMode { request: 4, mode: Mode::Classify });
    assert_eq!(answer.expect("an answer").result, AckResult::Ok);
    assert_eq!(rig.board.resets.len(), 2, "no panic");
}

#[test]
fn out_of_range_for_longer_than_the_supervision_timeout_it_advertises_again() {
    if !tests::has_linked_image() {
        return;
    }
    let mut rig = joined(15.0);
    rig.run_ms(1000);
    rig.board.controller().in_range = false;
    rig.run_ms(5000);
    assert!(!rig.board.controller().is_connected());
    assert_eq!(rig.noticed("lost").len(), 1);
    rig.board.controller().in_range = true;
    let from = rig.board.now();
    rig.join(15.0);
    let states = rig.heard.states.len();
    assert!(rig.run_until_that(2000, |rig| rig.heard.states.len() > states));
    println!("states again {} ms after the laptop looked for the board", (rig.board.now() - from) / ms(1));
    assert_eq!(rig.damaged(), 0);
}

/// Builds an L2CAP packet for this channel, with a length that may be wrong.
fn l2cap(channel: u16, len: u16, content: &[u8]) -> Vec<u8> {
    [&len.to_le_bytes()[..], &channel.to_le_bytes(), content].concat()
}

/// Builds a random packet, as a faulty or hostile device may send.
fn random_packet(random: &mut fastrand::Rng) -> Vec<u8> {
    // The channel is ATT, signalling or SMP, or sometimes any other number.
    let channel = *random.choice(&[4, 4, 4, 5, 6, 6]).unwrap();
    let channel = if random.u8(..16) == 0 { random.u16(..) } else { channel };
    let many = random.usize(0..=60);
    let content: Vec<u8> = std::iter::repeat_with(|| random.u8(..)).take(many).collect();
    let len = if random.u8(..8) == 0 { random.u16(..300) } else { content.len() as u16 };
    l2cap(channel, len, &content)
}

/// Returns packets that bumble sends to a board, so that a test can mutate them.
fn sensible() -> Vec<Vec<u8>> {
    let att: [&[u8]; 12] = [
        &[0x02, 0x05, 0x02],
        &[0x04, 1, 0, 0xFF, 0xFF],
        &[0x08, 1, 0, 0xFF, 0xFF, 0x03, 0x28],
        &[0x10, 1, 0, 0xFF, 0xFF, 0x00, 0x28],
        &[0x06, 1, 0, 0xFF, 0xFF, 0x00, 0x28, 0x0F, 0x18],
        &[0x0A, 3, 0],
        &[0x0C, 3, 0, 0, 0],
        &[0x12, 12, 0, 1, 0],
        &[0x52, 14, 0, 1, 2, 3, 0],
        &[0x16, 14, 0, 0, 0, 1, 2, 3],
        &[0x18, 1],
        &[0x20, 3, 0, 5, 0],
    ];
    let signalling: [&[u8]; 4] = [
        &[0x12, 1, 8, 0, 6, 0, 12, 0, 0, 0, 200, 0],
        &[0x13, 1, 2, 0, 0, 0],
        &[0x14, 2, 10, 0, 0x25, 0, 0x40, 0, 23, 0, 23, 0, 1, 0],
        &[0x01, 1, 2, 0, 0, 0],
    ];
    let smp: [&[u8]; 7] = [
        &[0x01, 3, 0, 0x0D, 16, 3, 3],
        &[0x03; 17],
        &[0x04; 17],
        &[0x0C; 65],
        &[0x0D; 17],
        &[0x05, 8],
        &[0x08; 17],
    ];
    let all =
        att.iter().map(|c| (4, c)).chain(signalling.iter().map(|c| (5, c))).chain(smp.iter().map(|c| (6, c)));
    all.map(|(channel, content)| l2cap(channel, content.len() as u16, content)).collect()
}

fn mutated_packet(random: &mut fastrand::Rng, from: &[Vec<u8>]) -> Vec<u8> {
    let mut packet = random.choice(from).unwrap().clone();
    for _ in 0..random.usize(1..4) {
        match random.u8(..4) {
            0 => {
                let at = random.usize(..packet.len());
                packet[at] ^= 1 << random.u8(..8);
            }
            1 => {
                // The changed byte is behind the channel, so that most packets still reach a receiver.
                let at = random.usize(4.min(packet.len() - 1)..packet.len());
                packet[at] = random.u8(..);
            }
            2 => packet.truncate(random.usize(1..=packet.len())),
            _ => packet.extend((0..random.usize(..20)).map(|_| random.u8(..))),
        }
    }
    if packet.len() >= 4 && random.u8(..4) > 0 {
        let len = (packet.len() as u16 - 4).to_le_bytes();
        packet[..2].copy_from_slice(&len);
    }
    packet
}

/// Sends such packets over the air to a board with a bonded laptop.
/// If the board disconnects, the laptop connects again.
fn bombard(seed: u64, mut next: impl FnMut(&mut fastrand::Rng) -> Vec<u8>) {
    let count = if is_full() { 100_000 } else { 300 };
    let mut rig = joined(7.5);
    rig.run_ms(1500);
    let tap = rig.board.tap("bimanual_sample", 0);
    let panics = rig.board.tap_panics().expect("a handler");
    let mut random = fastrand::Rng::with_seed(seed);
    let (mut sent, mut joins) = (0, 0);
    while sent < count {
        if !rig.board.controller().is_connected() {
            rig.run_ms(200);
            rig.get(json!({"do": "connect", "interval": 7.5}));
            if rig.want(json!({"do": "encrypt"})).is_err() {
                rig.run_ms(100);
                continue;
            }
            joins += 1;
        }
        while sent < count && rig.board.controller().waiting_down() < 12 {
            let packet = next(&mut random);
            // The packet is sent in one radio packet, or split into two.
            if packet.len() > 8 && random.u8(..8) == 0 {
                let (a, b) = packet.split_at(random.usize(1..packet.len()));
                rig.board.controller().inject(a, true);
                rig.board.controller().inject(b, random.u8(..16) == 0);
            } else {
                rig.board.controller().inject(&packet, true);
            }
            sent += 1;
            if sent % 10_000 == 0 {
                println!("{sent} packets so far");
            }
        }
        rig.run_ms(5);
        let places = rig.board.panics(panics);
        assert!(places.is_empty(), "the image panics within {sent} packets: {places:?}");
    }
    rig.run_ms(500);
    let samples = samples_without_a_gap(&rig, tap);
    let free = rig.heard.statuses.last().expect("a status").free_stack_bytes;
    println!(
        "{sent} packets, {joins} new connections, {samples} samples, each 10 ms after the last; {free} B of stack unused"
    );
    assert_eq!(rig.board.resets, STARTED_ONCE);
    // The owner's keys still work, and the board still executes requests.
    if rig.board.controller().is_connected() {
        rig.get(json!({"do": "disconnect"}));
    }
    rig.run_ms(500);
    rig.join(15.0);
    rig.get(json!({"do": "write", "uuid": IN, "bytes": "00"}));
    let answer = rig.ask(5, &HostMessage::SetMode { request: 5, mode: Mode::Classify });
    assert_eq!(answer.expect("an answer").result, AckResult::Ok);
    assert_eq!(
        rig.heard.states.iter().filter(|state| state.events != 0).count(),
        0,
        "no gesture out of nothing"
    );
}

#[test]
fn random_packets_do_not_stop_it() {
    if !tests::has_linked_image() {
        return;
    }
    bombard(24, random_packet);
}

/// Most of these packets have a correct length, so the image's guard (`shared_board::guard`) accepts them.
/// The host stack must survive every packet that the guard accepts.
#[test]
fn mutated_packets_do_not_stop_it() {
    if !tests::has_linked_image() {
        return;
    }
    let from = sensible();
    bombard(25, move |random| mutated_packet(random, &from));
}
