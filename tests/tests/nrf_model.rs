//! Tests sending a model over the wire: it is stored, it is used after the restart, and no failure loses the old model.
#![cfg(feature = "nrf")]

use shared_dsp::right::kind::FeatureKind;
use shared_dsp::right::network::{Model, crc32};
use shared_proto::message::{
    AckResult, Bytes, FaultKind, HostMessage, MODEL_CHUNK_MAX, ModelBegin, ModelInfo,
};
use tests::nrf::lsm9ds1::Still;
use tests::nrf::session::RightRig;
use tests::nrf::transfer::{announce, begin, model_id, pieces, random_model, restart};

/// Returns a model of the paper's shape.
fn other_model(seed: u32) -> Vec<u8> {
    random_model(FeatureKind::Raw, &[20, 10, 5], seed)
}

#[test]
fn a_model_is_kept_after_its_check_and_used_after_the_restart() {
    let mut session = RightRig::uart(Box::new(Still));
    session.run_ms(2500);
    let old = model_id(&mut session);
    for seed in 1..4 {
        let blob = other_model(seed);
        let model = Model::parse(&blob).unwrap();
        let dropped = session.heard.statuses.last().map_or(0, |s| s.dropped_samples);
        assert_eq!(announce(&mut session, begin(&blob, &model)), AckResult::Ok);
        pieces(&mut session, &blob, usize::MAX);
        let before = model_id(&mut session);
        let ack = session.ask(9, &HostMessage::ModelCommit { request: 9, crc32: crc32(&blob) }).unwrap();
        assert_eq!(ack.result, AckResult::Ok);
        assert_eq!(model_id(&mut session), before, "not before the restart");
        session.run_ms(1100);
        let lost = session.heard.statuses.last().unwrap().dropped_samples - dropped;
        println!("model {:08x}: {} bytes, {lost} samples lost during the transfer", crc32(&blob), blob.len());
        assert!(seed == 1 || lost <= 8, "erasing loses samples");
        restart(&mut session);
        assert_eq!(model_id(&mut session), crc32(&blob));
        assert_ne!(model_id(&mut session), old);
        session.run_ms(1100);
    }
    assert!(
        !session.heard.faults.iter().any(|f| f.kind == FaultKind::ModelDamaged || f.kind == FaultKind::Panic)
    );
}

#[test]
fn a_transfer_that_breaks_at_any_piece_leaves_the_old_model() {
    let mut session = RightRig::uart(Box::new(Still));
    session.run_ms(500);
    // A received model runs, so that both slots are tested.
    let kept = other_model(1);
    assert_eq!(announce(&mut session, begin(&kept, &Model::parse(&kept).unwrap())), AckResult::Ok);
    pieces(&mut session, &kept, usize::MAX);
    let commit = HostMessage::ModelCommit { request: 9, crc32: crc32(&kept) };
    assert_eq!(session.ask(9, &commit).unwrap().result, AckResult::Ok);
    restart(&mut session);

    let blob = other_model(2);
    let model = Model::parse(&blob).unwrap();
    let all = blob.len().div_ceil(MODEL_CHUNK_MAX);
    let step = if tests::is_full() { 1 } else { 8 };
    let mut broken = 0;
    for after in (0..=all).step_by(step) {
        assert_eq!(announce(&mut session, begin(&blob, &model)), AckResult::Ok);
        pieces(&mut session, &blob, after);
        restart(&mut session);
        assert_eq!(model_id(&mut session), crc32(&kept), "broken after {after} pieces");
        broken += 1;
    }
    // The complete model arrives, but one bit in the middle differs from the announced checksum.
    let mut wrong = blob.clone();
    wrong[1000] ^= 4;
    assert_eq!(announce(&mut session, begin(&blob, &model)), AckResult::Ok);
    pieces(&mut session, &wrong, usize::MAX);
    let commit = HostMessage::ModelCommit { request: 9, crc32: crc32(&blob) };
    assert_eq!(session.ask(9, &commit).unwrap().result, AckResult::BadChecksum);
    restart(&mut session);
    assert_eq!(model_id(&mut session), crc32(&kept));
    println!("{broken} transfers broken between pieces (of {all}), one damaged: the old model stands");
    assert!(session.heard.states.iter().all(|s| s.events == 0));
}

#[test]
fn models_that_this_image_cannot_run_are_refused_before_anything_is_erased() {
    let mut session = RightRig::uart(Box::new(Still));
    session.run_ms(500);
    let blob = other_model(1);
    let model = Model::parse(&blob).unwrap();
    let good = begin(&blob, &model);
    let info = good.info;
    for bad in [
        ModelBegin { info: ModelInfo { axes: 12, ..info }, ..good },
        ModelBegin { info: ModelInfo { recipe: 99, ..info }, ..good },
        ModelBegin { info: ModelInfo { sample_hz: 104, ..info }, ..good },
        ModelBegin { info: ModelInfo { window: 128, ..info }, ..good },
        ModelBegin { size: 1 << 20, ..good },
    ] {
        assert_eq!(announce(&mut session, bad), AckResult::ModelDoesNotFit);
    }
    let chunk = HostMessage::ModelChunk { request: 2, offset: 0, data: Bytes(&blob[..16]) };
    assert_eq!(session.ask(2, &chunk).unwrap().result, AckResult::WrongOffset);
    assert_eq!(session.board.soc().nvmc.erased, 0);
}
