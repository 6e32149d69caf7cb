//! Runs `host-bridge update` against an emulated Nano 33 over its USB port.
//! The board has the second stage and the image with Bluetooth linked in.
//! Board and program share a simulated time.
#![cfg(all(feature = "nrf", unix))]

use std::process::ExitStatus;
use std::time::Duration;

use models::synth::Wearer;
use shared_board::update::{TAIL_BYTES, Trailer};
use shared_proto::message::Board;
use tests::desk::program::{Desk, Running};
use tests::desk::programs::{bridge, run};
use tests::desk::right::{Right, RightStation};
use tests::nrf::build::{Variant, image};
use tests::nrf::update_file::{NEW, OLD, update_file};

/// A board with the old image and its port.
struct Bench {
    desk: Desk,
    right: RightStation,
    port: String,
}

impl Bench {
    fn start(name: &str) -> Self {
        let desk = Desk::new(name);
        let right = Right::start_linked(&desk, "nano33", Wearer::demo(1));
        let port = right.port();
        Self { desk, right, port }
    }

    /// Saves an update file, and returns its path.
    fn save(&self, name: &str, file: &[u8]) -> String {
        std::fs::write(self.desk.path(name), file).expect("a file");
        self.desk.text(name)
    }

    fn start_update(&self, file: &str) -> Running {
        bridge(&self.desk, &["update", file, "--port", &self.port])
    }

    /// Advances the time until a condition of the board holds.
    fn pass_until(&self, what: &str, seconds: u64, holds: impl Fn(&Right) -> bool) {
        for _ in 0..seconds * 10 {
            if self.right.with(|board| holds(board)) {
                return;
            }
            self.desk.pass(Duration::from_millis(100));
        }
        panic!("{what}: not within {seconds} s");
    }

    /// Waits until the program has sent the image, the board has restarted and an image runs.
    /// During the exchange, the board has no port.
    fn finish(&self, mut update: Running) -> (ExitStatus, String) {
        self.right.pull_when(|board| board.has_restarted());
        update.wait(&["exchanges it"]);
        self.pass_until("a restart", 5, Right::has_restarted);
        let from_ms = self.right.board_ms();
        self.pass_until("an image", 60, Right::is_running);
        println!("an image runs {} ms after the restart", self.right.board_ms() - from_ms);
        self.right.plug();
        update.end()
    }

    fn has(&self, version: &str) {
        let (status, text) = run(&self.desk, &["list", &self.port]);
        assert!(status.success() && text.contains(&format!("firmware {version}")), "{version}: {text}");
    }
}

fn nano(version: &str) -> Vec<u8> {
    update_file(&image(Variant::Trouble), Board::RightNano33, version)
}

#[test]
fn update_replaces_the_image_and_puts_the_old_one_back_though_the_cable_is_pulled_once() {
    if !tests::has_linked_image_and_time() {
        return;
    }
    let bench = Bench::start("update");
    bench.has(OLD);
    let from_ms = bench.right.board_ms();
    let (status, text) = bench.finish(bench.start_update(&bench.save("new.update", &nano(NEW))));
    println!("{OLD} to {NEW}: {} ms", bench.right.board_ms() - from_ms);
    assert!(status.success(), "{text}");
    for word in [
        &format!("the right hand (Nano 33 BLE Sense), firmware {OLD} → {NEW}, "),
        &format!("firmware {NEW} runs, has said hello, and stays"),
    ] {
        assert!(text.contains(word), "{word} in\n{text}");
    }
    // The cable is also the power supply, so the board starts again.
    bench.right.pull();
    bench.right.plug();
    bench.has(NEW);

    // On the way back, the cable is pulled in the middle of the transfer.
    let written = bench.right.with(Right::words_written);
    bench.right.pull_when(move |board| board.words_written() > written + 20_000);
    let mut update = bench.start_update(&bench.save("old.update", &nano(OLD)));
    update.wait(&["comes back by itself"]);
    bench.right.plug();
    update.wait(&["the board restarted: from the start"]);
    let (status, text) = bench.finish(update);
    assert!(status.success() && text.contains(&format!("firmware {OLD} runs")), "{text}");
    bench.has(OLD);
}

#[test]
fn an_update_file_that_is_refused_changes_nothing_and_the_program_says_what_to_do() {
    if !tests::has_linked_image_and_time() {
        return;
    }
    let bench = Bench::start("update-refused");
    bench.has(OLD);
    let before = bench.right.with(Right::flash);
    let file = nano(NEW);
    let mut damaged = file.clone();
    damaged[200_000] ^= 1;
    let damaged = bench.save("damaged.update", &damaged);
    let left = update_file(&image(Variant::Trouble), Board::LeftXiao, NEW);
    let left = bench.save("left.update", &left);
    for (file, words) in [
        (&damaged, "the file is damaged; build it or download it again"),
        (&left, "choose the file for this board"),
    ] {
        let (status, text) = run(&bench.desk, &["update", file, "--port", &bench.port]);
        assert!(!status.success() && text.contains(words), "{words} in\n{text}");
        assert!(bench.right.with(Right::flash) == before, "the board has changed: {text}");
    }
    // Only the board itself notices that an image starts at another address.
    let trailer = Trailer { origin: 0x2D000, ..Trailer::read(&file).expect("a file") };
    let file = bench.save("address.update", &trailer.file(&file[..file.len() - TAIL_BYTES]));
    let (status, text) = bench.finish(bench.start_update(&file));
    let says =
        format!("build or download the file for this board, or sign it with that key; firmware {OLD} runs");
    assert!(!status.success() && text.contains(&says), "{text}");
    bench.has(OLD);
}
