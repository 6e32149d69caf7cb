//! Tests updates of the image `trouble` on the emulated board, without a debug probe.
//! The tests install a new image and then the old image again, over USB and over Bluetooth.
//! They also cover signatures, an image that never says hello, and power cuts during the exchange of the images.
//!
//! The second stage, the image and bumble's Bluetooth stack are real.
//! The flash with its timing and the timing of the radio are emulated.
#![cfg(feature = "nrf")]

use std::sync::OnceLock;

use ed25519_compact::{KeyPair, Noise, Seed};
use host_bridge::upload::{Stage, Upload};
use shared_board::update::{JOURNAL, NEW_IMAGE, SIGNATURE_BYTES, SLOT_A, SLOT_B, Trailer};
use shared_dsp::right::network::crc32;
use shared_proto::frame::{BOARD_FRAME_MAX, Decoder, encode_host};
use shared_proto::message::{AckResult, Board, BoardMessage, HostMessage};
use tests::nrf::board::Kind;
use tests::nrf::build::{Variant, image};
use tests::nrf::lsm9ds1::Still;
use tests::nrf::session::RightRig;
use tests::nrf::time::ms;
use tests::nrf::update_file::{NEW, OLD, update_file};
use tests::nrf::usb_host::UsbHost;

/// Address of the second stage on a Nano 33.
const BASE: u32 = 0x1_0000;

fn key() -> KeyPair {
    KeyPair::from_seed(Seed::new([7; 32]))
}

fn sign(file: &mut [u8], key: &KeyPair) {
    let (signed, place) = file.split_at_mut(file.len() - SIGNATURE_BYTES);
    place.copy_from_slice(&*key.sk.sign(&*signed, None::<Noise>));
}

/// A board with a second stage, the old image and the key. The desk also has the files of both images.
struct Desk {
    rig: RightRig,
    usb: UsbHost,
    decoder: Decoder<BOARD_FRAME_MAX>,
    versions: Vec<String>,
    acks: Vec<shared_proto::message::Ack>,
    old: Vec<u8>,
    new: Vec<u8>,
}

/// The contents of the flash when the board starts: an image in each slot, and the journal.
struct Before<'f> {
    a: &'f [u8],
    b: (u32, &'f [u8]),
    /// The words of the journal.
    journal: Vec<u32>,
}

/// Returns a journal that requests an update. `shared_board::update` describes the format.
fn request(file: &[u8], source: u32) -> Vec<u32> {
    vec![u32::from_le_bytes(*b"BMJ1"), file.len() as u32, crc32(file), source]
}

const CABLE: u32 = 0x600D_CAB1;
const AIR: u32 = 0;

fn files() -> (Vec<u8>, Vec<u8>) {
    let linked = image(Variant::Trouble);
    [OLD, NEW].map(|version| update_file(&linked, Board::RightNano33, version)).into()
}

impl Desk {
    fn new() -> Self {
        Self::start(None, Some(*key().pk))
    }

    fn start(before: Option<Before<'_>>, key: Option<[u8; 32]>) -> Self {
        let mut linked = image(Variant::Trouble);
        let (old, new) = files();
        let is_first_start = before.is_none();
        if let Some(Before { a, b, journal }) = before {
            let words = journal.iter().flat_map(|word| word.to_le_bytes()).collect();
            linked.pieces = vec![
                (BASE + SLOT_A, a.to_vec()),
                (BASE + SLOT_B + b.0, b.1.to_vec()),
                (BASE + JOURNAL, words),
            ];
        }
        let whole = linked.behind(image(Variant::Stage), key);
        let rig = RightRig::air_of(whole, Kind::Nano33, Box::new(Still));
        let (usb, decoder) = (UsbHost::default(), Decoder::new());
        let mut desk = Self { rig, usb, decoder, versions: Vec::new(), acks: Vec::new(), old, new };
        if is_first_start {
            // At the very first start, the image sets up the reset pin.
            desk.rig.run_ms(700);
        } else {
            desk.set_up_pin();
        }
        desk
    }

    /// A left hand with a second stage and the old image.
    fn left() -> Self {
        let linked = image(Variant::XiaoLeft);
        let [old, new] = [OLD, NEW].map(|version| update_file(&linked, Board::LeftXiao, version));
        let whole = linked.behind(image(Variant::XiaoStage), None);
        let mut rig = RightRig::air_of(whole, Kind::Xiao, Box::new(Still));
        rig.run_ms(700);
        let (usb, decoder) = (UsbHost::default(), Decoder::new());
        Self { rig, usb, decoder, versions: Vec::new(), acks: Vec::new(), old, new }
    }

    /// Starts a board with the new image in slot B and a request to install it.
    fn waiting(new: &[u8], source: u32, key: Option<[u8; 32]>) -> Self {
        let (old, _) = files();
        let before = Before { a: &old, b: (NEW_IMAGE, new), journal: request(new, source) };
        Self::start(Some(before), key)
    }

    /// Sets up the chip's UICR as an earlier start would have done, so the image does not restart for this.
    fn set_up_pin(&mut self) {
        static UICR: OnceLock<Vec<u8>> = OnceLock::new();
        let uicr = UICR.get_or_init(|| {
            let mut rig = RightRig::air(Kind::Nano33, Box::new(Still));
            rig.run_ms(700);
            assert_eq!(rig.board.resets.len(), 1);
            rig.board.soc().uicr.clone()
        });
        self.rig.board.soc().uicr.copy_from_slice(uicr);
        self.rig.board.power_cycle();
    }

    fn plug_in(&mut self) {
        self.usb.plug_in(&mut self.rig.board);
        for _ in 0..2000 {
            self.step();
            if self.usb.is_ready() {
                return;
            }
        }
        panic!("the cable does not attach");
    }

    fn step(&mut self) {
        self.rig.run_ms(1);
        self.usb.step(&mut self.rig.board);
        for byte in self.usb.read(&mut self.rig.board) {
            match self.decoder.push_board(byte) {
                Some(BoardMessage::Hello(hello)) => self.versions.push(hello.firmware.to_string()),
                Some(BoardMessage::Ack(ack)) => self.acks.push(ack),
                _ => {}
            }
        }
    }

    fn write(&mut self, message: &HostMessage<'_>) {
        let mut buffer = [0; 512];
        let frame = encode_host(message, &mut buffer).expect("fits").to_vec();
        self.usb.write(&mut self.rig.board, &frame);
    }

    /// Sends a file over the cable, and returns when the board has accepted the file.
    fn send(&mut self, file: &[u8]) {
        let mut upload = Upload::image(file, 1);
        let from = self.rig.board.now();
        while *upload.stage() != Stage::Done {
            let now_ms = self.rig.board.now() / ms(1);
            if let Some(message) = upload.poll(now_ms) {
                self.write(&message);
            }
            self.step();
            for ack in std::mem::take(&mut self.acks) {
                upload.ack(&ack);
            }
            assert!(!matches!(upload.stage(), Stage::Failed(_)), "{:?}", upload.stage());
            assert!(self.rig.board.now() - from < ms(200_000), "{:?}", upload.progress());
        }
        println!("{} bytes in {} ms", file.len(), (self.rig.board.now() - from) / ms(1));
    }

    /// Sends a file over Bluetooth, and returns when the board has accepted the file.
    fn send_over_air(&mut self, file: &[u8]) {
        let mut upload = Upload::image(file, 1);
        let from = self.rig.board.now();
        let mut heard = self.rig.heard.acks.len();
        while *upload.stage() != Stage::Done {
            let now_ms = self.rig.board.now() / ms(1);
            if let Some(message) = upload.poll(now_ms) {
                self.rig.send(&message);
            }
            self.rig.run_ms(1);
            while let Some(ack) = self.rig.heard.acks.get(heard) {
                upload.ack(ack);
                heard += 1;
            }
            assert!(!matches!(upload.stage(), Stage::Failed(_)), "{:?}", upload.stage());
            assert!(self.rig.board.now() - from < ms(600_000), "{:?}", upload.progress());
        }
        println!(
            "{} bytes in {} ms over Bluetooth (modelled)",
            file.len(),
            (self.rig.board.now() - from) / ms(1)
        );
    }

    fn wait_for_restart(&mut self, restarts: usize) {
        let from = self.rig.board.now();
        while self.rig.board.resets.len() < restarts {
            self.rig.run_ms(1);
            assert!(self.rig.board.now() - from < ms(5000), "no restart");
        }
    }

    /// Waits until the board has restarted this many times and its image is running.
    fn wait_for_start(&mut self, restarts: usize) {
        self.wait_for_restart(restarts);
        self.wait_for_image();
    }

    fn wait_for_image(&mut self) {
        let from = self.rig.board.now();
        // A sleeping core shows that the image is running, because the second stage never sleeps.
        while !self.rig.board.is_asleep() {
            self.rig.run_ms(10);
            assert!(self.rig.board.now() - from < ms(60_000), "no image starts");
        }
        println!("an image runs {} ms after the restart", (self.rig.board.now() - from) / ms(1));
        self.rig.run_ms(700);
    }

    /// Sends a message about a file over the cable, and returns the board's answer.
    fn ask(&mut self, message: &HostMessage<'_>) -> Option<AckResult> {
        self.acks.clear();
        self.write(message);
        (0..400).find_map(|_| {
            self.step();
            self.acks.first().map(|ack| ack.result)
        })
    }

    fn confirm(&mut self, file: &[u8]) -> Option<AckResult> {
        self.ask(&HostMessage::ImageConfirm { request: 77, crc32: crc32(file) })
    }

    fn version(&mut self) -> String {
        self.versions.clear();
        self.write(&HostMessage::HelloRequest);
        for _ in 0..400 {
            self.step();
            if let Some(version) = self.versions.pop() {
                return version;
            }
        }
        panic!("no hello");
    }
}

#[test]
fn over_the_cable_old_becomes_new_and_old_again() {
    if !tests::has_linked_image() {
        return;
    }
    old_becomes_new_and_old_again(Desk::new());
}

#[test]
fn over_the_cable_a_left_hand_s_image_becomes_new_and_old_again() {
    if !tests::has_linked_image_and_time() {
        return;
    }
    old_becomes_new_and_old_again(Desk::left());
}

fn old_becomes_new_and_old_again(mut desk: Desk) {
    desk.plug_in();
    assert_eq!(desk.version(), OLD);
    for (file, version) in [(desk.new.clone(), NEW), (desk.old.clone(), OLD)] {
        let restarts = desk.rig.board.resets.len();
        desk.send(&file);
        desk.wait_for_start(restarts + 1);
        desk.plug_in();
        assert_eq!(desk.confirm(&file), Some(AckResult::Ok));
        assert_eq!(desk.version(), version);
        // The image is still there after a power cut.
        desk.rig.board.power_cycle();
        desk.rig.run_ms(1500);
        desk.plug_in();
        assert_eq!(desk.version(), version);
    }
}

#[test]
fn over_bluetooth_a_signed_image_becomes_the_running_one_and_the_old_one_again() {
    if !tests::has_linked_image_and_time() {
        return;
    }
    let mut desk = Desk::new();
    desk.rig.join(7.5);
    for (mut file, version) in [(desk.new.clone(), NEW), (desk.old.clone(), OLD)] {
        sign(&mut file, &key());
        desk.rig.get(serde_json::json!({"do": "parameters", "interval": 7.5, "latency": 0}));
        desk.rig.run_ms(200);
        let restarts = desk.rig.board.resets.len();
        desk.send_over_air(&file);
        desk.wait_for_start(restarts + 1);
        desk.rig.run_ms(2000);
        // The laptop reconnects with the keys of the earlier bond.
        desk.rig.join(7.5);
        let confirm = HostMessage::ImageConfirm { request: 77, crc32: crc32(&file) };
        assert_eq!(desk.rig.ask(77, &confirm).map(|ack| ack.result), Some(AckResult::Ok));
        let hellos = desk.rig.heard.versions.len();
        desk.rig.send(&HostMessage::HelloRequest);
        desk.rig.run_ms(200);
        assert_eq!(desk.rig.heard.versions[hellos..].last().map(String::as_str), Some(version));
    }
}

#[test]
fn over_bluetooth_an_image_without_the_key_s_signature_does_not_run() {
    if !tests::has_linked_image() {
        return;
    }
    let (_, new) = files();
    let (mut signed, mut by_another, mut changed) = (new.clone(), new.clone(), new.clone());
    sign(&mut signed, &key());
    sign(&mut by_another, &KeyPair::from_seed(Seed::new([8; 32])));
    sign(&mut changed, &key());
    // One bit of the code is changed after signing, and all checksums are recomputed.
    changed[200_000] ^= 1;
    let signature = changed[changed.len() - SIGNATURE_BYTES..].to_vec();
    let trailer = Trailer::read(&new).expect("a file");
    changed.truncate(changed.len() - shared_board::update::TAIL_BYTES);
    let mut changed = trailer.file(&changed);
    let start = changed.len() - SIGNATURE_BYTES;
    changed[start..].copy_from_slice(&signature);
    let here = Some(*key().pk);
    for (what, file, key) in [
        ("unsigned", &new, here),
        ("by another", &by_another, here),
        ("changed", &changed, here),
        ("no key in the board", &signed, None),
    ] {
        let mut desk = Desk::waiting(file, AIR, key);
        desk.wait_for_image();
        desk.plug_in();
        assert_eq!(
            (desk.confirm(file), desk.version()),
            (Some(AckResult::ImageRefused), OLD.into()),
            "{what}"
        );
    }
}

#[test]
fn an_image_for_another_address_does_not_run_even_by_cable() {
    if !tests::has_linked_image() {
        return;
    }
    let (_, new) = files();
    let trailer = Trailer { origin: 0x2_7000 + SLOT_A, ..Trailer::read(&new).expect("a file") };
    let file = trailer.file(&new[..new.len() - shared_board::update::TAIL_BYTES]);
    let mut desk = Desk::waiting(&file, CABLE, None);
    desk.wait_for_image();
    desk.plug_in();
    assert_eq!((desk.confirm(&file), desk.version()), (Some(AckResult::ImageRefused), OLD.into()));
}

#[test]
fn an_image_that_says_no_hello_before_the_next_restart_makes_room_for_the_old_one() {
    if !tests::has_linked_image() {
        return;
    }
    let (_, new) = files();
    let mut desk = Desk::waiting(&new, CABLE, None);
    desk.wait_for_image();
    let slot = (BASE + SLOT_A) as usize;
    assert!(desk.rig.board.soc().flash[slot..].starts_with(&new), "the new image is on trial");
    desk.rig.board.power_cycle();
    desk.wait_for_image();
    desk.plug_in();
    assert_eq!((desk.confirm(&new), desk.version()), (Some(AckResult::ImageWentBack), OLD.into()));
}

#[test]
fn of_20_power_cuts_while_images_are_exchanged_none_leaves_the_board_without_one() {
    if !tests::has_linked_image() {
        return;
    }
    let (old, new) = files();
    let mut random = fastrand::Rng::with_seed(24);
    let mut marks = request(&new, CABLE);
    marks.resize(16 + 128, u32::MAX);
    // These marks mean that all pages were exchanged and the new image was started.
    marks[16..].fill(0);
    marks[9] = 0;
    let cuts = if tests::is_full() { 20 } else { 4 };
    for cut in 0..cuts {
        let forth = cut % 2 == 0;
        let (before, version) = if forth {
            (Before { a: &old, b: (NEW_IMAGE, &new), journal: request(&new, CABLE) }, NEW)
        } else {
            (Before { a: &new, b: (0, &old), journal: marks.clone() }, OLD)
        };
        let mut desk = Desk::start(Some(before), None);
        // An exchange writes about 130,000 words and pages in total.
        let operation = random.u64(1..120_000);
        desk.rig.board.soc().nvmc.fails_after = Some(operation);
        let from = desk.rig.board.now();
        while desk.rig.board.soc().nvmc.fails_after != Some(0) {
            desk.rig.run_ms(1);
            assert!(desk.rig.board.now() - from < ms(60_000), "cut {cut}: nothing fails");
        }
        let at = (desk.rig.board.now() - from) / ms(1);
        desk.rig.board.power_cycle();
        desk.wait_for_image();
        desk.plug_in();
        assert_eq!(desk.version(), version);
        let expected = if forth { &new } else { &old };
        let slot = (BASE + SLOT_A) as usize;
        assert!(desk.rig.board.soc().flash[slot..].starts_with(expected), "cut {cut}");
        println!("cut {cut} at operation {operation}, {at} ms after the start: {version} runs");
    }
}
