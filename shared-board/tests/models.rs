//! Checks that a board receives a model either completely or not at all.
//! No failure of the line or of the power supply may change this.

mod common;

use common::Line;
use proptest::prelude::*;
use shared_board::hand::model_info_on_the_wire;
use shared_board::memory::{RamFlash, at_once};
use shared_board::models::{Found, MappedFlash, ModelRequest, ModelStore, Runs};
use shared_board::slots::{BLOB_MAX, Slot};
use shared_dsp::right::network::{Model, crc32};
use shared_proto::message::{AckResult, MODEL_CHUNK_MAX, ModelBegin, ModelInfo};

const RUNS: Runs = Runs { axes: 3, sample_hz: 100 };

/// A small model that depends on `seed`.
/// Because of its text, its length is not a multiple of a piece's length.
fn blob(seed: i8) -> Vec<u8> {
    spec(seed, 3, 8)
}

fn spec(seed: i8, axes: usize, hop: u16) -> Vec<u8> {
    common::model(&["idle", "one"], axes, hop, |_| seed)
}

fn begin(blob: &[u8]) -> ModelBegin<'_> {
    let model = Model::parse(blob).expect("a model");
    ModelBegin {
        request: 1,
        info: model_info_on_the_wire(model.info()),
        scaling: ModelBegin::DATA_SHEET_SCALING,
        size: blob.len() as u32,
    }
}

/// Sends a request and returns the last answer: its result and the next expected offset.
fn ask(store: &mut ModelStore<RamFlash>, request: &ModelRequest<'_>) -> (AckResult, u32) {
    let mut line = Line::default();
    at_once(store.answer(request, async || (), &mut line));
    let last = *line.all_acks().last().expect("an answer");
    (last.result, last.next_offset)
}

/// Sends pieces, beginning at `offset`. Returns the first answer that is not `Ok`.
fn pieces(store: &mut ModelStore<RamFlash>, blob: &[u8], mut offset: usize) -> Option<AckResult> {
    while offset < blob.len() {
        let end = (offset + MODEL_CHUNK_MAX).min(blob.len());
        let chunk = ModelRequest::Chunk { request: 2, offset: offset as u32, data: &blob[offset..end] };
        match ask(store, &chunk) {
            (AckResult::Ok, next) => assert_eq!(next as usize, end),
            (result, _) => return Some(result),
        }
        offset = end;
    }
    None
}

/// Sends a complete model and returns the board's result.
fn send(store: &mut ModelStore<RamFlash>, blob: &[u8]) -> AckResult {
    match ask(store, &ModelRequest::Begin(begin(blob))) {
        (AckResult::Ok, 0) => {}
        (result, _) => return result,
    }
    if let Some(result) = pieces(store, blob, 0) {
        return result;
    }
    ask(store, &ModelRequest::Commit { request: 3, crc32: crc32(blob) }).0
}

fn open(flash: RamFlash) -> (ModelStore<RamFlash>, Found) {
    ModelStore::open(flash, RUNS)
}

/// Returns the CRC of the model that a board would run from this flash.
fn running(flash: RamFlash) -> Option<u32> {
    let (store, found) = open(flash);
    let place = found.model?;
    Some(crc32(&store.flash().mapped()[place.offset()..place.offset() + place.len]))
}

/// Creates the flash of a board that has received these models and restarted after each.
fn with(models: &[Vec<u8>]) -> RamFlash {
    models.iter().fold(RamFlash::blank(), |flash, blob| {
        let mut store = open(flash).0;
        assert_eq!(send(&mut store, blob), AckResult::Ok);
        store.into_flash()
    })
}

#[test]
fn the_model_that_was_sent_last_runs_after_the_restart() {
    let models: Vec<_> = (1..6).map(blob).collect();
    for n in 0..models.len() {
        let flash = with(&models[..n]);
        let last = n.checked_sub(1).map(|last| crc32(&models[last]));
        assert_eq!(running(flash.clone()), last);
        assert!(!open(flash).1.damaged);
    }
}

#[test]
fn every_answer_names_the_offset_that_is_wanted_next() {
    let blob = blob(1);
    let mut line = Line::default();
    let mut store = open(RamFlash::blank()).0;
    at_once(store.answer(&ModelRequest::Begin(begin(&blob)), async || (), &mut line));
    assert_eq!(line.acks(), [(1, AckResult::Started), (1, AckResult::Ok)]);
    let chunk =
        |offset: u32| ModelRequest::Chunk { request: 2, offset, data: &blob[offset as usize..][..64] };
    assert_eq!(ask(&mut store, &chunk(64)), (AckResult::WrongOffset, 0));
    assert_eq!(ask(&mut store, &chunk(0)), (AckResult::Ok, 64));
    // The answer was lost, so the piece is sent again.
    assert_eq!(ask(&mut store, &chunk(0)), (AckResult::WrongOffset, 64));
    // These pieces are too early, too long or too short, or do not consist of complete words.
    let commit = ModelRequest::Commit { request: 3, crc32: crc32(&blob) };
    assert_eq!(ask(&mut store, &commit), (AckResult::WrongOffset, 64));
    let bad = |data| ModelRequest::Chunk { request: 2, offset: 64, data };
    for data in [&[][..], &[0; 7], &[0; MODEL_CHUNK_MAX + 4]] {
        assert_eq!(ask(&mut store, &bad(data)), (AckResult::OutOfRange, 64));
    }
    assert_eq!(pieces(&mut store, &blob, 64), None);
    assert_eq!(ask(&mut store, &commit), (AckResult::Ok, 0));
    // The transfer has ended, so there is no announced model.
    assert_eq!(ask(&mut store, &commit), (AckResult::WrongOffset, 0));
}

#[test]
fn each_erased_page_is_followed_by_a_pause() {
    let blob = blob(1);
    let mut store = open(RamFlash::blank()).0;
    let mut pauses = 0;
    let mut line = Line::default();
    at_once(store.answer(&ModelRequest::Begin(begin(&blob)), async || pauses += 1, &mut line));
    assert_eq!(pauses, 4);
}

#[test]
fn what_cannot_run_is_refused_before_anything_is_erased() {
    let blob = blob(1);
    let good = begin(&blob);
    let info = good.info;
    let mut store = open(RamFlash::blank()).0;
    for bad in [
        ModelBegin { info: ModelInfo { axes: 9, ..info }, ..good },
        ModelBegin { info: ModelInfo { recipe: 99, ..info }, ..good },
        ModelBegin { info: ModelInfo { sample_hz: 104, ..info }, ..good },
        ModelBegin { info: ModelInfo { window: 128, ..info }, ..good },
        // This model uses the scale of Arduino's library.
        ModelBegin { scaling: [1.0, 1.1469, 1.1469], ..good },
        ModelBegin { size: 0, ..good },
        ModelBegin { size: BLOB_MAX as u32 + 1, ..good },
    ] {
        assert_eq!(ask(&mut store, &ModelRequest::Begin(bad)), (AckResult::ModelDoesNotFit, 0));
    }
    assert_eq!(store.flash().operations, 0);
}

#[test]
fn a_model_that_was_announced_as_another_one_is_not_kept() {
    let kept = blob(1);
    let sent = blob(2);
    let mut wrong = sent.clone();
    wrong[100] ^= 4;
    let flash = with(std::slice::from_ref(&kept));
    // One bit changes during the transfer.
    let mut store = open(flash.clone()).0;
    ask(&mut store, &ModelRequest::Begin(begin(&sent)));
    assert_eq!(pieces(&mut store, &wrong, 0), None);
    let commit = ModelRequest::Commit { request: 3, crc32: crc32(&sent) };
    assert_eq!(ask(&mut store, &commit).0, AckResult::BadChecksum);
    assert_eq!(running(store.into_flash()), Some(crc32(&kept)));
    // The announcement differs from the blob, which has a hop that this image does not support.
    let other_hop = spec(2, 3, 10);
    let mut store = open(flash).0;
    assert_eq!(send(&mut store, &other_hop), AckResult::ModelDoesNotFit);
    assert_eq!(running(store.into_flash()), Some(crc32(&kept)));
}

#[test]
fn a_damaged_slot_is_reported_and_the_other_one_is_used() {
    let models = [blob(1), blob(2)];
    let mut flash = with(&models);
    assert_eq!(running(flash.clone()), Some(crc32(&models[1])));
    *flash.byte_mut(Slot::B.offset() + 200) ^= 1;
    let (store, found) = open(flash);
    assert_eq!((found.damaged, found.model.unwrap().slot), (true, Slot::A));
    // The next transfer goes to the damaged slot.
    let mut store = store;
    assert_eq!(send(&mut store, &blob(3)), AckResult::Ok);
    let flash = store.into_flash();
    assert_eq!(running(flash.clone()), Some(crc32(&blob(3))));
    assert!(!open(flash).1.damaged);
}

#[test]
fn the_newer_model_is_found_across_the_end_of_the_sequence_numbers() {
    // The test sets the sequence number in the first slot's header to four below the maximum.
    let mut flash = with(&[blob(1)]);
    for (i, byte) in (u32::MAX - 3).to_le_bytes().into_iter().enumerate() {
        *flash.byte_mut(12 + i) = byte;
    }
    for seed in 2..10 {
        let mut store = open(flash).0;
        assert_eq!(send(&mut store, &blob(seed)), AckResult::Ok);
        flash = store.into_flash();
        assert_eq!(running(flash.clone()), Some(crc32(&blob(seed))), "model {seed}");
    }
}

#[test]
fn two_transfers_without_a_restart_leave_the_newer_one() {
    for before in 0..3 {
        let models: Vec<_> = (1..=before).map(blob).collect();
        let mut store = open(with(&models)).0;
        assert_eq!(send(&mut store, &blob(10)), AckResult::Ok);
        assert_eq!(send(&mut store, &blob(11)), AckResult::Ok);
        assert_eq!(running(store.into_flash()), Some(crc32(&blob(11))), "{before} models before");
    }
}

/// Returns the number of words and pages that a transfer changes.
fn operations(blob: &[u8]) -> u32 {
    let mut store = open(RamFlash::blank()).0;
    assert_eq!(send(&mut store, blob), AckResult::Ok);
    store.flash().operations
}

#[test]
fn power_that_goes_at_any_word_leaves_the_old_model_or_the_new_one_and_the_next_transfer_works() {
    let (old, new, next) = (blob(1), blob(2), blob(3));
    let all = operations(&new);
    for before in [with(&[]), with(std::slice::from_ref(&old)), with(&[blob(9), old.clone()])] {
        let runs_before = running(before.clone());
        let mut kept_new = 0;
        for cut in 1..=all {
            let mut flash = before.clone();
            flash.cut_after = Some(cut);
            flash.torn = cut;
            let mut store = open(flash).0;
            assert_eq!(send(&mut store, &new), AckResult::StorageFailed, "cut at {cut} of {all}");
            let mut flash = store.into_flash();
            flash.power_up();
            let runs = running(flash.clone());
            assert!(runs == runs_before || runs == Some(crc32(&new)), "cut at {cut} of {all}: {runs:?}");
            kept_new += u32::from(runs != runs_before);
            let mut store = open(flash).0;
            assert_eq!(send(&mut store, &next), AckResult::Ok, "after the cut at {cut}");
            assert_eq!(running(store.into_flash()), Some(crc32(&next)), "after the cut at {cut}");
        }
        // Only the very last word makes the new model valid.
        assert!(kept_new <= 1, "{kept_new}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// A board that had a model still has a model after any number of power cuts, at any word and bit.
    #[test]
    fn a_board_that_had_a_model_has_one_after_any_number_of_power_cuts(
        cuts in prop::collection::vec((1u32..80, any::<u32>()), 1..12),
    ) {
        let mut models: Vec<u32> = vec![crc32(&blob(1))];
        let mut flash = with(&[blob(1)]);
        for (i, &(cut, torn)) in cuts.iter().enumerate() {
            let new = blob(2 + i as i8);
            models.push(crc32(&new));
            flash.cut_after = Some(cut);
            flash.torn = torn;
            let mut store = open(flash).0;
            send(&mut store, &new);
            flash = store.into_flash();
            flash.power_up();
            let runs = running(flash.clone());
            prop_assert!(runs.is_some_and(|id| models.contains(&id)), "{:?}", runs);
        }
    }
}
