//! A model sent over the wire: kept, used after the restart, and never at the cost of the old one.
#![cfg(feature = "nrf")]

use shared_dsp::mlp::{BlobSpec, DenseSpec, Model, build_blob, crc32};
use shared_dsp::recipe::Recipe;
use shared_proto::message::{AckResult, FaultKind, HostMessage, MODEL_CHUNK_MAX, ModelBegin, ModelInfo};
use tests::nrf::lsm9ds1::Still;
use tests::nrf::session::Session;

/// Another model of the same shape, with weights from a seed.
fn other_model(seed: u32) -> Vec<u8> {
    let sizes = [117, 20, 10, 5, 7];
    let mut state = seed;
    let mut random = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        ((state >> 24) as i8).max(-127)
    };
    let layers = (0..4)
        .map(|l| DenseSpec {
            weights: (0..sizes[l + 1]).map(|_| (0..sizes[l]).map(|_| random()).collect()).collect(),
            biases: (0..sizes[l + 1]).map(|_| i32::from(random()) * 16).collect(),
            input_scale: 0.05,
            input_zero_point: 0,
            weight_scale: 0.01,
            output_scale: 0.05,
            output_zero_point: if l < 3 { -128 } else { 0 },
            relu: l < 3,
        })
        .collect();
    build_blob(&BlobSpec {
        recipe: Recipe::Raw,
        axes: 9,
        sample_hz: 100,
        window: 200,
        hop: 8,
        labels: ["idle", "a", "b", "c", "d", "e", "f"].map(String::from).to_vec(),
        scaling: vec![(1.0, 0.0); 117],
        layers,
    })
    .expect("a valid model")
}

fn begin<'a>(blob: &'a [u8], model: &Model<'a>) -> ModelBegin<'a> {
    let info = model.info();
    ModelBegin {
        request: 1,
        info: ModelInfo {
            model_id: crc32(blob),
            recipe: info.recipe.id(),
            axes: info.axes as u8,
            sample_hz: info.sample_hz,
            window: info.window,
            labels: info.label_text,
        },
        scaling: [1.0; 3],
        size: blob.len() as u32,
    }
}

/// Announces the model and waits until its place is empty.
fn announce(session: &mut Session, begin: ModelBegin<'_>) -> AckResult {
    let before = session.heard.acks.len();
    session.send(&HostMessage::ModelBegin(begin));
    session.run_until_that(2000, |s| s.heard.acks[before..].iter().any(|a| a.result != AckResult::Started));
    session.heard.acks.last().expect("an answer").result
}

/// Sends pieces until `most` have been taken.
fn pieces(session: &mut Session, blob: &[u8], most: usize) {
    for (i, data) in blob.chunks(MODEL_CHUNK_MAX).enumerate().take(most) {
        let offset = (i * MODEL_CHUNK_MAX) as u32;
        let ack =
            session.ask(100 + i as u16, &HostMessage::ModelChunk { request: 100 + i as u16, offset, data });
        assert_eq!(ack.map(|a| (a.result, a.next_offset)), Some((AckResult::Ok, offset + data.len() as u32)));
    }
}

fn restart(session: &mut Session) {
    session.board.soc().nvic.reset_wanted = true;
    session.run_ms(300);
}

fn model_id(session: &mut Session) -> u32 {
    session.send(&HostMessage::HelloRequest);
    let before = session.heard.hellos.len();
    assert!(session.run_until_that(500, |s| s.heard.hellos.len() > before), "no hello");
    session.heard.hellos.last().unwrap().1
}

#[test]
fn a_model_is_kept_after_its_check_and_used_after_the_restart() {
    let mut session = Session::uart(Box::new(Still));
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
    let mut session = Session::uart(Box::new(Still));
    session.run_ms(500);
    // A received model runs, so that both slots are at stake.
    let kept = other_model(1);
    assert_eq!(announce(&mut session, begin(&kept, &Model::parse(&kept).unwrap())), AckResult::Ok);
    pieces(&mut session, &kept, usize::MAX);
    let commit = HostMessage::ModelCommit { request: 9, crc32: crc32(&kept) };
    assert_eq!(session.ask(9, &commit).unwrap().result, AckResult::Ok);
    restart(&mut session);

    let blob = other_model(2);
    let model = Model::parse(&blob).unwrap();
    let all = blob.len().div_ceil(MODEL_CHUNK_MAX);
    let step = if std::env::var_os("BIMANUAL_FULL").is_some() { 1 } else { 8 };
    let mut broken = 0;
    for after in (0..=all).step_by(step) {
        assert_eq!(announce(&mut session, begin(&blob, &model)), AckResult::Ok);
        pieces(&mut session, &blob, after);
        restart(&mut session);
        assert_eq!(model_id(&mut session), crc32(&kept), "broken after {after} pieces");
        broken += 1;
    }
    // Wrong in the middle: everything arrives, but one bit differs from what was announced.
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
    let mut session = Session::uart(Box::new(Still));
    session.run_ms(500);
    let blob = other_model(1);
    let model = Model::parse(&blob).unwrap();
    let good = begin(&blob, &model);
    let info = good.info;
    for bad in [
        ModelBegin { info: ModelInfo { axes: 3, ..info }, ..good },
        ModelBegin { info: ModelInfo { recipe: 99, ..info }, ..good },
        ModelBegin { info: ModelInfo { sample_hz: 104, ..info }, ..good },
        ModelBegin { info: ModelInfo { window: 128, ..info }, ..good },
        ModelBegin { size: 1 << 20, ..good },
    ] {
        assert_eq!(announce(&mut session, bad), AckResult::ModelDoesNotFit);
    }
    let chunk = HostMessage::ModelChunk { request: 2, offset: 0, data: &blob[..16] };
    assert_eq!(session.ask(2, &chunk).unwrap().result, AckResult::WrongOffset);
    assert_eq!(session.board.soc().nvmc.erased, 0);
}
