//! Tests image updates: the transfer into flash, the exchange by the second stage, and power cuts at every word.

use std::sync::OnceLock;

use shared_board::images::{ImageStore, Then};
use shared_board::memory::{RamFlash, at_once};
use shared_board::models::{MappedFlash as _, ModelRequest};
use shared_board::swap::{self, Flash, Layout};
use shared_board::update::{NEW_IMAGE, NotAnImage, Progress, Request, Source, Trailer, read_journal};
use shared_board::{images, update};
use shared_dsp::right::network::crc32;
use shared_proto::frame::{BOARD_FRAME_MAX, Decoder};
use shared_proto::message::{AckResult, BoardMessage};

/// A flash that is small enough to test a power cut at every word.
const SMALL: Layout = Layout { a: 0, b: 8 * 128, journal: 17 * 128, pages: 8, page_bytes: 128 };
/// Number of words in the journal.
const JOURNAL_WORDS: usize = 64;
const REQUEST: [u32; 4] = [u32::from_le_bytes(*b"BMJ1"), 8 * 128, 7, 0x600D_CAB1];
const CONFIRMED: usize = 10;

#[derive(Debug)]
struct Cut;

/// NOR flash whose power fails during an operation. Any of the operation's bits may then be written.
#[derive(Clone)]
struct Nor {
    words: Vec<u32>,
    layout: Layout,
    left: Option<u32>,
    operations: u32,
    random: u32,
}

impl Nor {
    fn new(layout: Layout, old: &[u32], new: &[u32]) -> Self {
        let journal = layout.journal as usize / 4;
        let mut words = vec![u32::MAX; journal + JOURNAL_WORDS.max(layout.page_bytes as usize / 4)];
        words[layout.a as usize / 4..][..old.len()].copy_from_slice(old);
        words[(layout.b + layout.page_bytes) as usize / 4..][..new.len()].copy_from_slice(new);
        words[journal..journal + 4].copy_from_slice(&REQUEST);
        Self { words, layout, left: None, operations: 0, random: 1 }
    }

    fn mask(&mut self) -> u32 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 17;
        self.random ^= self.random << 5;
        // A quarter of the masks select no bits, and a quarter select all bits.
        match self.random % 4 {
            0 => 0,
            1 => u32::MAX,
            _ => self.random.rotate_left(11),
        }
    }

    /// Returns whether an operation is completed, is interrupted, or does not begin.
    fn works(&mut self) -> Option<bool> {
        self.operations += 1;
        match &mut self.left {
            None => Some(true),
            Some(0) => None,
            Some(left) => {
                *left -= 1;
                Some(*left > 0)
            }
        }
    }

    fn slot_a(&self) -> &[u32] {
        &self.words[..(self.layout.pages * self.layout.page_bytes) as usize / 4]
    }

    fn progress(&self) -> Option<Progress> {
        read_journal(|number| self.word(self.layout.journal + 4 * number)).map(|(_, progress)| progress)
    }

    fn confirm(&mut self) -> Result<(), Cut> {
        self.write(self.layout.journal + 4 * CONFIRMED as u32, 0)
    }
}

impl Flash for Nor {
    type Error = Cut;

    fn word(&self, at: u32) -> u32 {
        self.words[at as usize / 4]
    }

    fn write(&mut self, at: u32, word: u32) -> Result<(), Cut> {
        let at = at as usize / 4;
        match self.works() {
            Some(true) => self.words[at] &= word,
            Some(false) => {
                let reached = self.mask();
                self.words[at] &= word | !reached;
                return Err(Cut);
            }
            None => return Err(Cut),
        }
        Ok(())
    }

    fn copy_page(&mut self, from: u32, to: u32) -> Result<(), Cut> {
        let count = self.layout.page_bytes as usize / 4;
        let (from, to) = (from as usize / 4, to as usize / 4);
        match self.works() {
            Some(true) => self.words[to..to + count].fill(u32::MAX),
            Some(false) => {
                for at in to..to + count {
                    let reached = self.mask();
                    self.words[at] |= reached;
                }
                return Err(Cut);
            }
            None => return Err(Cut),
        }
        for i in 0..count {
            let word = self.words[from + i];
            self.write(4 * (to + i) as u32, word)?;
        }
        Ok(())
    }
}

fn pattern(layout: Layout, seed: u32) -> Vec<u32> {
    let words = layout.pages * layout.page_bytes / 4;
    (0..words).map(|i| i.wrapping_mul(2_654_435_761).rotate_left(seed) ^ seed).collect()
}

/// The behaviour of the new image after its start.
#[derive(Clone, Copy, Debug, PartialEq)]
enum After {
    Hello,
    Silence,
}

/// Runs a complete update, and restores the power after each cut. Returns how often the board started.
/// After each start that was not cut, slot A must contain one of the two images.
fn live(nor: &mut Nor, old: &[u32], new: &[u32], after: After) -> u32 {
    let accepts = |flash: &Nor, request: &Request| {
        assert_eq!(request.size, REQUEST[1]);
        let start = (flash.layout.b + flash.layout.page_bytes) as usize / 4;
        flash.words[start..start + new.len()] == *new
    };
    for starts in 1..10 {
        if swap::start(nor, nor.layout, accepts).is_err() {
            nor.left = None;
            continue;
        }
        let runs = nor.slot_a().to_vec();
        assert!(runs == old || runs == new, "neither the old nor the new image");
        match nor.progress() {
            Some(Progress::OnTrial) => {
                assert!(runs == new);
                if after == After::Hello && nor.confirm().is_err() {
                    nor.left = None;
                }
            }
            Some(Progress::Confirmed) => assert!(runs == new),
            Some(Progress::WentBack | Progress::Refused) => assert!(runs == old),
            other => panic!("{other:?} when an image starts"),
        }
        // After the end of the update, another start must not write anything.
        if nor.progress() != Some(Progress::OnTrial) {
            let before = nor.operations;
            swap::start(nor, nor.layout, accepts).expect("power");
            assert_eq!((nor.operations, nor.slot_a()), (before, &runs[..]));
            return starts;
        }
    }
    panic!("the update does not end");
}

fn images_of(layout: Layout) -> (Vec<u32>, Vec<u32>) {
    (pattern(layout, 3), pattern(layout, 17))
}

#[test]
fn an_image_that_says_hello_stays_and_a_silent_one_makes_room_for_the_old_one() {
    let (old, new) = images_of(SMALL);
    for (after, stays) in [(After::Hello, &new), (After::Silence, &old)] {
        let mut nor = Nor::new(SMALL, &old, &new);
        live(&mut nor, &old, &new, after);
        assert_eq!(nor.slot_a(), stays, "{after:?}");
    }
}

#[test]
fn an_image_that_is_not_accepted_changes_nothing() {
    let (old, new) = images_of(SMALL);
    let mut nor = Nor::new(SMALL, &old, &new);
    swap::start(&mut nor, SMALL, |_, _| false).unwrap();
    assert_eq!((nor.slot_a(), nor.progress()), (&old[..], Some(Progress::Refused)));
    assert_eq!(nor.operations, 1, "a mark");
}

#[test]
fn of_10_000_power_cuts_at_every_word_none_leaves_a_board_without_an_image() {
    let (old, new) = images_of(SMALL);
    let (mut cuts, mut stayed) = (0, 0);
    for after in [After::Hello, After::Silence] {
        let mut whole = Nor::new(SMALL, &old, &new);
        live(&mut whole, &old, &new, after);
        for seed in 1..=7 {
            for cut in 1..=whole.operations {
                let mut nor = Nor::new(SMALL, &old, &new);
                (nor.random, nor.left) = (seed * 7919 + cut, Some(cut));
                live(&mut nor, &old, &new, after);
                cuts += 1;
                stayed += u32::from(nor.slot_a() == new);
            }
        }
    }
    println!("{cuts} cuts, 0 bricked; after {stayed} the new image stayed");
    assert!(cuts >= 10_000);
    assert!(stayed > cuts / 4 && stayed < cuts / 2, "{stayed} of {cuts}");
}

#[test]
fn power_that_fails_again_and_again_only_costs_time() {
    let (old, new) = images_of(SMALL);
    let accepts = |_: &Nor, _: &Request| true;
    for every in [40, 50, 77] {
        let mut nor = Nor::new(SMALL, &old, &new);
        let mut starts = 0;
        while nor.progress() == Some(Progress::Waiting) {
            nor.left = Some(every);
            let _ = swap::start(&mut nor, SMALL, accepts);
            starts += 1;
            assert!(starts < 100, "no progress at a cut every {every} operations");
        }
        assert!(starts > 5);
        assert_eq!(nor.slot_a(), new);
    }
}

#[test]
fn a_board_s_own_layout_survives_cuts_too() {
    let layout = Layout::BOARD;
    let (old, new) = images_of(layout);
    let layout_at_zero =
        Layout { a: 0, b: layout.b - layout.a, journal: layout.journal - layout.a, ..layout };
    let mut request = Nor::new(layout_at_zero, &old, &new);
    let journal = layout_at_zero.journal as usize / 4;
    request.words[journal + 1] = REQUEST[1];
    for cut in [1, 2, 1026, 1027, 1028, 70_001, 131_000, 131_329, 131_330, 200_000, 262_600] {
        let mut nor = request.clone();
        (nor.random, nor.left) = (cut, Some(cut));
        live(&mut nor, &old, &new, After::Silence);
        assert_eq!(nor.slot_a(), old);
    }
}

/// Returns an image file that fills a few pages.
fn file() -> &'static [u8] {
    static FILE: OnceLock<Vec<u8>> = OnceLock::new();
    FILE.get_or_init(|| {
        let image: Vec<u8> = (0..9_001u32).map(|i| ((i * i) >> 3) as u8).collect();
        Trailer { origin: 0x14000, board: 1, version: *b"0.9.1\0\0\0\0\0\0\0\0\0\0\0" }.file(&image)
    })
}

#[test]
fn a_file_says_for_what_it_is_and_a_damaged_one_is_noticed() {
    let file = file();
    let trailer = Trailer::read(file).unwrap();
    assert_eq!((trailer.origin, trailer.board, trailer.version()), (0x14000, 1, "0.9.1"));
    assert_eq!(file.len(), 9_004 + update::TAIL_BYTES);
    assert_eq!(Trailer::read(&file[..file.len() - 4]), Err(NotAnImage::Kind));
    assert_eq!(Trailer::read(&file[..file.len() - 1]), Err(NotAnImage::Length));
    assert_eq!(Trailer::read(&[]), Err(NotAnImage::Length));
    assert_eq!(Trailer::read(&vec![0; update::IMAGE_MAX as usize + 4]), Err(NotAnImage::Length));
    let mut damaged = file.to_vec();
    damaged[5000] ^= 4;
    assert_eq!(Trailer::read(&damaged), Err(NotAnImage::Damaged));
}

struct Receiver(ImageStore<RamFlash>);

impl Receiver {
    fn new() -> Self {
        Self(ImageStore::new(RamFlash::of(images::STORE_BYTES)))
    }

    fn ask(&mut self, request: ModelRequest<'_>) -> (Then, Option<(AckResult, u32)>) {
        let mut said = None;
        let mut decoder = Decoder::<BOARD_FRAME_MAX>::new();
        let then = at_once(self.0.answer(&request, Source::Cable, async || (), &mut |frame: &[u8]| {
            for &byte in frame {
                if let Some(BoardMessage::Ack(ack)) = decoder.push_board(byte) {
                    said = Some((ack.result, ack.next_offset));
                }
            }
            true
        }));
        (then, said)
    }

    fn begin(&mut self, file: &[u8]) -> Option<(AckResult, u32)> {
        self.ask(ModelRequest::Image { request: 1, size: file.len() as u32, crc32: crc32(file) }).1
    }

    fn send(&mut self, file: &[u8]) -> (Then, Option<(AckResult, u32)>) {
        assert_eq!(self.begin(file), Some((AckResult::Ok, 0)));
        for (i, data) in file.chunks(128).enumerate() {
            let offset = 128 * i as u32;
            let (then, said) = self.ask(ModelRequest::Chunk { request: 2, offset, data });
            assert_eq!((then, said), (Then::Stay, Some((AckResult::Ok, offset + data.len() as u32))));
        }
        self.ask(ModelRequest::Commit { request: 3, crc32: crc32(file) })
    }

    fn word(&self, number: u32) -> u32 {
        let at = (update::JOURNAL - update::SLOT_B + 4 * number) as usize;
        u32::from_le_bytes(self.0.flash().mapped()[at..at + 4].try_into().unwrap())
    }

    /// Makes a mark in the journal, as the second stage does.
    fn mark(&mut self, number: u32) {
        let mut flash = self.0.clone().into_flash();
        let at = (update::JOURNAL - update::SLOT_B + 4 * number) as usize;
        (at..at + 4).for_each(|at| *flash.byte_mut(at) = 0);
        self.0 = ImageStore::new(flash);
    }

    fn confirm(&mut self, crc32: u32) -> AckResult {
        self.ask(ModelRequest::Confirm { request: 4, crc32 }).1.unwrap().0
    }
}

#[test]
fn a_transfer_fills_slot_b_and_asks_for_the_exchange() {
    let mut board = Receiver::new();
    let (then, said) = board.send(file());
    assert_eq!((then, said.unwrap().0), (Then::Restart, AckResult::Ok));
    let start = NEW_IMAGE as usize;
    assert_eq!(&board.0.flash().mapped()[start..start + file().len()], file());
    let (request, progress) = read_journal(|number| board.word(number)).expect("a request");
    assert_eq!(request.source, Source::Cable);
    assert_eq!((request.size as usize, request.crc32), (file().len(), crc32(file())));
    assert_eq!(progress, Progress::Waiting);
}

#[test]
fn pieces_out_of_order_are_refused_with_the_place_to_go_on_and_others_belong_to_models() {
    let mut board = Receiver::new();
    let chunk = |offset, data| ModelRequest::Chunk { request: 2, offset, data };
    assert_eq!(board.ask(chunk(0, &[0; 8])).0, Then::Pass);
    board.begin(file());
    assert_eq!(board.ask(chunk(0, &[1; 128])).1, Some((AckResult::Ok, 128)));
    assert_eq!(board.ask(chunk(0, &[1; 128])).1, Some((AckResult::WrongOffset, 128)));
    assert_eq!(board.ask(chunk(128, &[1; 3])).1, Some((AckResult::OutOfRange, 128)));
    let commit = ModelRequest::Commit { request: 3, crc32: crc32(file()) };
    assert_eq!(board.ask(commit).1, Some((AckResult::WrongOffset, 128)));
    let size = update::IMAGE_MAX + 4;
    assert_eq!(
        board.ask(ModelRequest::Image { request: 1, size, crc32: 1 }).1.unwrap().0,
        AckResult::OutOfRange
    );
    assert_eq!(board.ask(chunk(128, &[1; 128])).0, Then::Pass);
}

#[test]
fn bytes_with_another_checksum_are_not_requested() {
    let mut board = Receiver::new();
    let mut bad = file().to_vec();
    board.begin(&bad);
    bad[77] ^= 1;
    for (i, data) in bad.chunks(128).enumerate() {
        board.ask(ModelRequest::Chunk { request: 2, offset: 128 * i as u32, data });
    }
    let (then, said) = board.ask(ModelRequest::Commit { request: 3, crc32: crc32(file()) });
    assert_eq!((then, said.unwrap().0), (Then::Stay, AckResult::BadChecksum));
    assert_eq!(read_journal(|number| board.word(number)), None);
}

#[test]
fn the_laptop_hears_what_became_of_its_image() {
    let crc = crc32(file());
    let after = |marks: &[u32]| {
        let mut board = Receiver::new();
        board.send(file());
        marks.iter().for_each(|&mark| board.mark(mark));
        board
    };
    assert_eq!(Receiver::new().confirm(crc), AckResult::WrongOffset);
    assert_eq!(after(&[]).confirm(crc), AckResult::Busy);
    assert_eq!(after(&[8]).confirm(crc), AckResult::ImageRefused);
    assert_eq!(after(&[9, 11]).confirm(crc), AckResult::ImageWentBack);
    let mut board = after(&[9]);
    assert_eq!(board.confirm(crc ^ 1), AckResult::BadChecksum);
    // No transfer may overwrite the old image before the new image has said hello.
    assert_eq!(board.begin(file()).unwrap().0, AckResult::Busy);
    assert_eq!(board.confirm(crc), AckResult::Ok);
    assert_eq!(read_journal(|number| board.word(number)).unwrap().1, Progress::Confirmed);
    assert_eq!(board.confirm(crc), AckResult::Ok);
    assert_eq!(board.begin(file()).unwrap().0, AckResult::Ok);
    let mut board = after(&[9]);
    at_once(board.0.said_hello());
    assert_eq!(read_journal(|number| board.word(number)).unwrap().1, Progress::Confirmed);
}

#[test]
fn a_transfer_that_loses_power_at_any_word_requests_the_whole_image_or_nothing() {
    let mut whole = Receiver::new();
    // The flash contains the journal of an earlier update.
    whole.send(file());
    [9, 10].iter().for_each(|&mark| whole.mark(mark));
    let started = whole.0.clone().into_flash();
    whole.send(file());
    let total = whole.0.flash().operations - started.operations;
    let mut requested = 0;
    for cut in 1..=total + 1 {
        let mut flash = started.clone();
        (flash.cut_after, flash.torn) = (Some(cut), cut);
        let mut board = Receiver(ImageStore::new(flash));
        let ok = board.begin(file()).is_some_and(|said| said.0 == AckResult::Ok)
            && file().chunks(128).enumerate().all(|(i, data)| {
                let chunk = ModelRequest::Chunk { request: 2, offset: 128 * i as u32, data };
                board.ask(chunk).1.is_some_and(|said| said.0 == AckResult::Ok)
            });
        if ok {
            board.ask(ModelRequest::Commit { request: 3, crc32: crc32(file()) });
        }
        match read_journal(|number| board.word(number)) {
            // The power failed before the old journal was changed.
            Some((_, Progress::Confirmed)) => assert_eq!(cut, 1),
            Some((request, progress)) => {
                assert_eq!((request.crc32, progress), (crc32(file()), Progress::Waiting), "cut {cut}");
                assert!(cut >= total - 1, "cut {cut}");
                requested += 1;
            }
            None => {}
        }
    }
    println!("{total} cuts, {requested} with a request");
    assert!((1..=3).contains(&requested));
}
