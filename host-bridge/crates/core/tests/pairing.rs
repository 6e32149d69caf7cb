//! What a user learns about a board's Bluetooth pairing.

mod support;

use host_core::bridge::{Bridge, EventKind};
use host_core::intent::MotionMap;
use host_core::safety::Hand;
use shared_proto::message::{BoardMessage, Pairing, PairingKind};
use support::{NoRobot, encode, hello};

/// Returns the lines about pairing after a hello and these messages.
fn lines(said: &[(PairingKind, u32)]) -> Vec<String> {
    let (mut bridge, mut robot) = (Bridge::new(MotionMap::default()), NoRobot::default());
    bridge.receive(Hand::Left, &hello(1), 0, &mut robot);
    for &(kind, passkey) in said {
        let frame = encode(&BoardMessage::Pairing(Pairing { kind, passkey }));
        bridge.receive(Hand::Left, &frame, 1, &mut robot);
    }
    let events = bridge.take_events().into_iter();
    events
        .filter_map(|event| match event.kind {
            EventKind::Pairing { text, .. } => Some(text),
            _ => None,
        })
        .collect()
}

#[test]
fn a_passkey_is_shown_once_with_all_its_digits() {
    let passkey = (PairingKind::Passkey, 4_711);
    let lines = lines(&[passkey, passkey, passkey, (PairingKind::Passkey, 999_999)]);
    assert_eq!(lines.len(), 2, "{lines:?}");
    assert!(lines[0].contains("004711") && lines[1].contains("999999"), "{lines:?}");
}

#[test]
fn just_works_is_named_as_what_it_is() {
    let lines = lines(&[(PairingKind::JustWorks, 0), (PairingKind::PasskeyTyped, 0)]);
    assert!(lines[0].contains("just works") && lines[0].contains("nobody compared"), "{lines:?}");
    assert!(lines[1].contains("with a passkey") && !lines[1].contains("just works"), "{lines:?}");
}

#[test]
fn a_kind_or_number_of_a_later_version_is_no_nonsense() {
    let lines = lines(&[(PairingKind::Unknown(9), 0), (PairingKind::Passkey, u32::MAX)]);
    assert!(lines[0].contains("update host-bridge"), "{lines:?}");
    assert!(lines[1].contains("type 967295"), "{lines:?}");
}
