//! Arbitrary messages of every kind, made from plain random material.
#![allow(dead_code)] // each test file uses its part

use shared_proto::message::*;

mod rng;
pub use rng::Rng;

/// What a message is made of.
#[derive(Clone, Debug)]
pub struct Material {
    pub kind: usize,
    pub words: [u32; 10],
    pub bytes: Vec<u8>,
    pub text: String,
}

/// Kinds of [`BoardMessage`] and [`HostMessage`].
pub const BOARD_KINDS: usize = 11;
pub const HOST_KINDS: usize = 9;

impl Material {
    pub fn random(rng: &mut Rng) -> Self {
        let word = |rng: &mut Rng| {
            let bits = rng.next();
            // As many small numbers and zeros as in real frames, and the ends of each range.
            match bits >> 61 {
                0 | 1 => 0,
                2 => u32::MAX,
                3 | 4 => (bits as u32) & 0xFF,
                5 => (bits as u32) & 0xFFFF,
                _ => bits as u32,
            }
        };
        let kind = rng.below(BOARD_KINDS * HOST_KINDS);
        let words = std::array::from_fn(|_| word(rng));
        let len = rng.below(RAW_COUNTS_MAX + 1);
        let bytes = (0..len).map(|_| word(rng) as u8).collect();
        let text = (0..rng.below(LABELS_MAX + 1)).map(|_| char::from(b' ' + rng.below(95) as u8)).collect();
        Self { kind, words, bytes, text }
    }

    fn bytes(&self, max: usize) -> &[u8] {
        &self.bytes[..self.bytes.len().min(max)]
    }

    fn text(&self, max: usize) -> &str {
        &self.text[..self.text.floor_char_boundary(max)]
    }

    fn floats(&self) -> [f32; 3] {
        [5, 6, 7].map(|k: usize| f32::from_bits(self.words[k]))
    }

    fn mode(&self) -> Mode {
        [Mode::Classify, Mode::Record, Mode::Idle][self.words[6] as usize % 3]
    }

    fn model_info(&self) -> ModelInfo<'_> {
        let w = &self.words;
        ModelInfo {
            model_id: w[0],
            recipe: w[1] as u8,
            axes: w[2] as u8,
            sample_hz: w[3] as u16,
            window: w[4] as u16,
            labels: self.text(LABELS_MAX),
        }
    }

    pub fn board(&self) -> BoardMessage<'_> {
        let w = &self.words;
        match self.kind % BOARD_KINDS {
            0 => BoardMessage::Hello(Hello {
                major: w[0] as u8,
                minor: w[1] as u8,
                board: Board::from(w[2] as u8),
                firmware: self.text(FIRMWARE_MAX),
                boot_id: w[3],
                model_id: w[4],
                sample_hz: w[5] as u16,
            }),
            1 => BoardMessage::Left(LeftState {
                sequence: w[0] as u16,
                board_time_ms: w[1],
                pitch_mrad: w[2] as i16,
                roll_mrad: w[3] as i16,
                heading: [
                    Heading::Neutral,
                    Heading::Between,
                    Heading::Forward,
                    Heading::Backward,
                    Heading::Left,
                    Heading::Right,
                ][w[4] as usize % 6],
                index_bends: w[5] as u8,
                middle_bends: w[6] as u8,
                stop: w[7] & 1 == 1,
                health: w[8] as u8,
            }),
            2 => BoardMessage::Right(RightState {
                sequence: w[0] as u16,
                board_time_ms: w[1],
                events: w[2] as u8,
                label: w[3] as u8,
                confidence: w[4] as u8,
                event_window_end_ms: w[5],
                scores: self.bytes(SCORES_MAX),
                health: w[6] as u8,
            }),
            3 => BoardMessage::RawImu(RawImu {
                sequence: w[0] as u16,
                first_sample: w[1],
                axes: w[2] as u8,
                scale: self.floats(),
                counts: self.bytes(RAW_COUNTS_MAX),
            }),
            4 => BoardMessage::Status(Status {
                uptime_ms: w[0],
                dropped_samples: w[1],
                sensor_errors: w[2],
                bad_frames: w[3],
                free_stack_bytes: w[4],
                load_permille: w[5] as u16,
                mode: self.mode(),
            }),
            5 => BoardMessage::Fault(Fault {
                uptime_ms: w[0],
                kind: FaultKind::from(w[1] as u8),
                detail: w[2],
            }),
            6 => BoardMessage::Pong(Pong { id: w[0], board_time_ms: w[1] }),
            7 => BoardMessage::Ack(Ack {
                request: w[0] as u16,
                result: AckResult::from(w[1] as u8),
                next_offset: w[2],
            }),
            8 => BoardMessage::ModelInfo(self.model_info()),
            9 => BoardMessage::About(About {
                sensor: Sensor::from(w[0] as u8),
                axes: w[1] as u8,
                image: Image::from(w[2] as u8),
                reset: ResetCause::from(w[3] as u8),
                battery_mv: w[4] as u16,
            }),
            _ => BoardMessage::RawAdc(RawAdc {
                board_time_ms: w[0],
                counts: [1, 2, 3, 4, 5].map(|i| w[i] as u16),
            }),
        }
    }

    pub fn host(&self) -> HostMessage<'_> {
        let w = &self.words;
        let request = w[8] as u16;
        match self.kind % HOST_KINDS {
            0 => HostMessage::HelloRequest,
            1 => HostMessage::Ping { id: w[0] },
            2 => HostMessage::SetMode { request, mode: self.mode() },
            3 => HostMessage::Calibrate {
                request,
                step: [
                    CalibrationStep::Neutral,
                    CalibrationStep::Rest,
                    CalibrationStep::Bend,
                    CalibrationStep::Reset,
                ][w[0] as usize % 4],
            },
            4 => HostMessage::SetThresholds {
                request,
                thresholds: TiltThresholds {
                    neutral_mrad: w[0] as u16,
                    end_mrad: w[1] as u16,
                    start_mrad: w[2] as u16,
                },
            },
            5 => HostMessage::ModelBegin(ModelBegin {
                request,
                info: self.model_info(),
                scaling: self.floats(),
                size: w[9],
            }),
            6 => HostMessage::ModelChunk { request, offset: w[0], data: self.bytes(MODEL_CHUNK_MAX) },
            7 => HostMessage::ModelCommit { request, crc32: w[0] },
            _ => HostMessage::Feel { signal: Signal::from(w[0] as u8) },
        }
    }
}
