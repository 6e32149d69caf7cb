//! A laptop that sends a model to the emulated board in pieces.

use shared_board::hand::model_info_on_the_wire;
use shared_dsp::right::kind::FeatureKind;
use shared_dsp::right::network::{BlobSpec, DenseSpec, Model, build_blob, crc32};
use shared_proto::message::{AckResult, Bytes, HostMessage, MODEL_CHUNK_MAX, ModelBegin};

use super::session::RightRig;

/// Returns a model with nine axes, seven labels and random weights from a seed.
///
/// # Panics
/// Panics if the widths are too large for a blob.
pub fn random_model(recipe: FeatureKind, hidden: &[usize], seed: u32) -> Vec<u8> {
    const AXES: usize = 9;
    let inputs = recipe.feature_count(AXES);
    let sizes: Vec<usize> = [inputs].iter().chain(hidden).chain(&[7]).copied().collect();
    let mut state = seed;
    let mut random = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        ((state >> 24) as i8).max(-127)
    };
    let last = hidden.len();
    let layers = (0..=last)
        .map(|l| DenseSpec {
            weights: (0..sizes[l + 1]).map(|_| (0..sizes[l]).map(|_| random()).collect()).collect(),
            biases: (0..sizes[l + 1]).map(|_| i32::from(random()) * 16).collect(),
            input_scale: 0.05,
            input_zero_point: 0,
            weight_scales: vec![0.01],
            output_scale: 0.05,
            output_zero_point: if l < last { -128 } else { 0 },
            relu: l < last,
            largest: i8::MAX,
        })
        .collect();
    // The features of recipe 3 are centred on 0 with a deviation of 1.
    let scale = if recipe == FeatureKind::Aligned { 60.0 } else { 1.0 };
    build_blob(&BlobSpec {
        recipe,
        axes: AXES,
        sample_hz: 100,
        window: 200,
        hop: 8,
        labels: ["idle", "a", "b", "c", "d", "e", "f"].map(String::from).to_vec(),
        scaling: vec![(scale, 0.0); inputs],
        layers,
    })
    .expect("a valid model")
}

/// Returns the announcement of a model.
pub fn begin<'a>(blob: &'a [u8], model: &Model<'a>) -> ModelBegin<'a> {
    ModelBegin {
        request: 1,
        info: model_info_on_the_wire(model.info()),
        scaling: ModelBegin::DATA_SHEET_SCALING,
        size: blob.len() as u32,
    }
}

/// Announces the model and waits until its slot is erased. Returns the answer.
///
/// # Panics
/// Panics if there is no answer.
pub fn announce(session: &mut RightRig, begin: ModelBegin<'_>) -> AckResult {
    let before = session.heard.acks.len();
    session.send(&HostMessage::ModelBegin(begin));
    session.run_until_that(2000, |s| s.heard.acks[before..].iter().any(|a| a.result != AckResult::Started));
    session.heard.acks.last().expect("an answer").result
}

/// Sends pieces until `most` have been accepted.
///
/// # Panics
/// Panics if the board refuses a piece.
pub fn pieces(session: &mut RightRig, blob: &[u8], most: usize) {
    for (i, data) in blob.chunks(MODEL_CHUNK_MAX).enumerate().take(most) {
        let offset = (i * MODEL_CHUNK_MAX) as u32;
        let ack = session.ask(
            100 + i as u16,
            &HostMessage::ModelChunk { request: 100 + i as u16, offset, data: Bytes(data) },
        );
        assert_eq!(ack.map(|a| (a.result, a.next_offset)), Some((AckResult::Ok, offset + data.len() as u32)));
    }
}

/// Restarts the board.
pub fn restart(session: &mut RightRig) {
    session.board.soc().nvic.reset_wanted = true;
    session.run_ms(300);
}

/// Returns the id of the running model.
///
/// # Panics
/// Panics if the board sent no hello.
pub fn model_id(session: &mut RightRig) -> u32 {
    session.send(&HostMessage::HelloRequest);
    let before = session.heard.hellos.len();
    assert!(session.run_until_that(500, |s| s.heard.hellos.len() > before), "no hello");
    session.heard.hellos.last().unwrap().1
}

/// Sends a complete model, which runs after a restart.
///
/// # Panics
/// Panics if the board does not accept the model.
pub fn install(session: &mut RightRig, blob: &[u8]) {
    let model = Model::parse(blob).expect("a model");
    assert_eq!(announce(session, begin(blob, &model)), AckResult::Ok);
    pieces(session, blob, usize::MAX);
    let commit = HostMessage::ModelCommit { request: 9, crc32: crc32(blob) };
    assert_eq!(session.ask(9, &commit).expect("an answer").result, AckResult::Ok);
    restart(session);
    assert_eq!(model_id(session), crc32(blob));
}
