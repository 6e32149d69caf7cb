//! The laptop's end of the line to a board.
#![allow(dead_code)] // each test file uses its own part

use shared_board::FrameOut;
use shared_dsp::right::kind::FeatureKind;
use shared_dsp::right::network::{BlobSpec, DenseSpec, build_blob};
use shared_proto::frame::{BOARD_FRAME_MAX, Decoder, HOST_FRAME_MAX, encode_host};
use shared_proto::message::{Ack, AckResult, BoardMessage, Fault, HostMessage, LeftState, Pong, Status};

/// Accepts frames while it has room, and decodes them.
#[derive(Default)]
pub struct Line {
    bytes: Vec<u8>,
    /// Whether the line is full, so that it accepts no frame.
    pub is_full: bool,
}

impl FrameOut for Line {
    fn send(&mut self, frame: &[u8]) -> bool {
        if !self.is_full {
            self.bytes.extend_from_slice(frame);
        }
        !self.is_full
    }
}

impl Line {
    /// Deletes all received messages.
    pub fn clear(&mut self) {
        self.bytes.clear();
    }

    /// Returns the messages that `pick` selects, and does not delete them.
    pub fn all<T>(&self, pick: impl Fn(BoardMessage<'_>) -> Option<T>) -> Vec<T> {
        let mut decoder = Decoder::<BOARD_FRAME_MAX>::new();
        let mut picked = Vec::new();
        for &byte in &self.bytes {
            picked.extend(decoder.push_board(byte).and_then(&pick));
        }
        let counters = decoder.counters();
        assert_eq!(
            counters.damaged() + counters.malformed + counters.unknown,
            0,
            "a board sends whole frames"
        );
        picked
    }

    pub fn left(&self) -> Vec<LeftState> {
        self.all(|m| if let BoardMessage::Left(state) = m { Some(state) } else { None })
    }

    pub fn acks(&self) -> Vec<(u16, AckResult)> {
        self.all_acks().into_iter().map(|ack| (ack.request, ack.result)).collect()
    }

    pub fn all_acks(&self) -> Vec<Ack> {
        self.all(|m| if let BoardMessage::Ack(ack) = m { Some(ack) } else { None })
    }

    pub fn faults(&self) -> Vec<Fault> {
        self.all(|m| if let BoardMessage::Fault(fault) = m { Some(fault) } else { None })
    }

    pub fn statuses(&self) -> Vec<Status> {
        self.all(|m| if let BoardMessage::Status(status) = m { Some(status) } else { None })
    }

    pub fn pongs(&self) -> Vec<Pong> {
        self.all(|m| if let BoardMessage::Pong(pong) = m { Some(pong) } else { None })
    }

    /// Returns the boot ids of all hellos.
    pub fn hellos(&self) -> Vec<u32> {
        self.all(|m| if let BoardMessage::Hello(hello) = m { Some(hello.boot_id) } else { None })
    }
}

/// Builds a network of one layer on raw samples; `weight` returns the weight at each position.
pub fn model(labels: &[&str], axes: usize, hop: u16, weight: impl Fn(usize) -> i8) -> Vec<u8> {
    let inputs = FeatureKind::Raw.feature_count(axes);
    let row = |row: usize| (0..inputs).map(|i| weight(row * inputs + i)).collect();
    build_blob(&BlobSpec {
        recipe: FeatureKind::Raw,
        axes,
        sample_hz: 100,
        window: 200,
        hop,
        labels: labels.iter().map(|label| label.to_string()).collect(),
        scaling: vec![(1.0, 0.0); inputs],
        layers: vec![DenseSpec {
            weights: (0..labels.len()).map(row).collect(),
            biases: vec![0; labels.len()],
            input_scale: 0.05,
            input_zero_point: 0,
            weight_scales: vec![0.01],
            output_scale: 0.05,
            output_zero_point: 0,
            relu: false,
            largest: 127,
        }],
    })
    .expect("a valid model")
}

/// Encodes a message of the laptop as a frame.
pub fn frame(message: &HostMessage<'_>) -> Vec<u8> {
    encode_host(message, &mut [0; HOST_FRAME_MAX]).expect("fits").to_vec()
}
