//! Every message that crosses the wire: a table for each direction.
//!
//! A row is `number Name fields => boards, minor version that added it`. All else about a message follows from its row:
//! its place in the enum, the buffer sizes in [`frame`](crate::frame), what a left board takes ([`LeftRequest`]), and the rows
//! of `WIRE.md` with the golden frames, which tests compare with [`BoardMessage::ROWS`] and [`HostMessage::ROWS`].
//!
//! A message is a [postcard](https://postcard.jamesmunns.com/wire-format) enum: one byte of variant
//! number, then the fields in order. State travels whole and events travel as wrapping counters, so
//! a lost frame loses nothing and a repeated one does nothing.
//!
//! **Adding** a message at the end of a table, or a value to an open list ([`Board`], [`FaultKind`], [`AckResult`]: they have
//! `Unknown`), is a minor change; anything else is a major one (see [`PROTOCOL_MAJOR`]). [`Hello`] and
//! [`HostMessage::HelloRequest`] are frozen for ever, so that any two versions can tell each other that they differ.

use crate::frame::{ParseError, frame_len};
use postcard::experimental::max_size::MaxSize;
use serde::{Deserialize, Serialize};

#[macro_use]
mod table;
mod bounded;
mod hello;
mod signal;

pub use bounded::{Bytes, Text};
pub use hello::{About, Board, Hello, Image, ResetCause, Sensor};
pub use shared_words::{Heading, TiltThresholds, health};
pub use signal::Signal;
pub(crate) use table::largest;
pub use table::{BoardBody, Boards, Row};

/// Raised when a message is reshaped; both sides must have the same one.
pub const PROTOCOL_MAJOR: u8 = 1;
/// Raised when a message is added; the older side ignores what it does not know.
pub const PROTOCOL_MINOR: u8 = 4;

board_messages! {
    /// What a board sends to the laptop.
    BoardMessage<'a> {
        /// At start, and in answer to [`HostMessage::HelloRequest`].
        #[serde(borrow)]
        0 Hello(Hello<'a>) => Both, 0;
        /// The left hand's whole state, at 50 Hz and at once on a change.
        1 Left(LeftState) => Left, 0;
        /// The right hand's whole state, once per hop (80 ms).
        #[serde(borrow)]
        2 Right(RightState<'a>) => Right, 0;
        /// Samples as the window saw them, in record mode only.
        #[serde(borrow)]
        3 RawImu(RawImu<'a>) => Right, 0;
        /// Counters, once per second.
        4 Status(Status) => Both, 0;
        /// Something is wrong that a person should know about.
        5 Fault(Fault) => Both, 0;
        /// Answer to [`HostMessage::Ping`].
        6 Pong(Pong) => Both, 0;
        /// Answer to every other request.
        7 Ack(Ack) => Both, 0;
        /// What the running model expects and names, sent after each hello of a right hand.
        #[serde(borrow)]
        8 ModelInfo(ModelInfo<'a>) => Right, 0;
        /// What a right hand's board is made of, sent after each hello.
        9 About(About) => Right, 1;
        /// One sample of a left hand's converter, in record mode only.
        10 RawAdc(RawAdc) => Left, 3;
    }
}

host_messages! {
    /// What the laptop sends to a board.
    HostMessage<'a> {
        /// Who are you?
        0 HelloRequest => Both, 0;
        /// Answered by [`Pong`] with the same id.
        1 Ping {
            /// Chosen by the laptop.
            id: u32,
        } => Both, 0;
        /// Change what the board does.
        2 SetMode {
            /// Echoed in the [`Ack`].
            request: u16,
            /// The new mode.
            mode: Mode,
        } => Both, 0;
        /// Start one step of the left hand's calibration.
        3 Calibrate {
            /// Echoed in the [`Ack`].
            request: u16,
            /// Which pose the hand holds now.
            step: CalibrationStep,
        } => Both, 0;
        /// Change the left hand's tilt thresholds until the next restart.
        4 SetThresholds {
            /// Echoed in the [`Ack`].
            request: u16,
            /// The new thresholds.
            thresholds: TiltThresholds,
        } => Both, 0;
        /// Announce a model blob; the board answers with the offset it wants next.
        #[serde(borrow)]
        5 ModelBegin(ModelBegin<'a>) => Right, 0;
        /// A piece of the blob. Pieces arrive in order; the [`Ack`] names the next offset.
        6 ModelChunk {
            /// Echoed in the [`Ack`].
            request: u16,
            /// Where in the blob the data belongs, in bytes.
            offset: u32,
            /// A piece of the blob.
            #[serde(borrow)]
            data: Bytes<'a, MODEL_CHUNK_MAX>,
        } => Right, 0;
        /// Verify and keep the blob; used after the next restart.
        7 ModelCommit {
            /// Echoed in the [`Ack`].
            request: u16,
            /// CRC-32 of the whole blob, which is also the new model id.
            crc32: u32,
        } => Right, 0;
        /// What the wearer of a right hand shall feel, if a motor is wired to its board. Not acknowledged: a late one
        /// is worth nothing. Boards of earlier versions are not sent it.
        8 Feel {
            /// What.
            signal: Signal,
        } => Right, 2;
    }
}

/// Largest piece of a model in one frame, in bytes. All but the last have this size.
pub const MODEL_CHUNK_MAX: usize = 128;
/// Largest [`RawImu::counts`], in bytes: 8 samples of 9 axes.
pub const RAW_COUNTS_MAX: usize = 8 * 9 * 2;
/// Longest [`ModelInfo::labels`], in bytes of UTF-8, commas included.
pub const LABELS_MAX: usize = 96;
/// Longest [`RightState::scores`]: the most labels that a model may have.
pub const SCORES_MAX: usize = 32;
/// Longest [`Hello::firmware`], in bytes of UTF-8.
pub const FIRMWARE_MAX: usize = 32;

/// The left hand, whole.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct LeftState {
    /// One more for each frame of this message, wrapping.
    pub sequence: u16,
    /// Board clock at the newest sample in this state, wrapping after 49 days.
    pub board_time_ms: u32,
    /// Tilt about the lateral axis in milliradians, positive = forward.
    pub pitch_mrad: i16,
    /// Tilt about the forward axis in milliradians, positive = left.
    pub roll_mrad: i16,
    /// What the tilt means, debounced.
    pub heading: Heading,
    /// Bends of the index finger since start, wrapping.
    pub index_bends: u8,
    /// Bends of the middle finger since start, wrapping.
    pub middle_bends: u8,
    /// Both fingers have been held bent for 300 ms.
    pub stop: bool,
    /// Bits of [`health`]; 0 = all well.
    pub health: u8,
}

/// The right hand, whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct RightState<'a> {
    /// One more for each frame of this message, wrapping.
    pub sequence: u16,
    /// Board clock at the newest sample of the window, wrapping after 49 days.
    pub board_time_ms: u32,
    /// Gestures performed since start, wrapping.
    pub events: u8,
    /// Index (in the model's labels) of the last event's gesture; 255 before the first.
    pub label: u8,
    /// Confidence of the last event, 0 to 255 = 0 to 1.
    pub confidence: u8,
    /// Board clock at the end of the window that decided the last event.
    pub event_window_end_ms: u32,
    /// The network's int8 outputs as bytes, one per label: (score + 128) / 256 is the probability.
    #[serde(borrow)]
    pub scores: Bytes<'a, SCORES_MAX>,
    /// Bits of [`health`]; 0 = all well.
    pub health: u8,
}

/// Samples exactly as the window saw them: i16 counts on the 100 Hz grid.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, MaxSize)]
pub struct RawImu<'a> {
    /// One more for each frame of this message, wrapping.
    pub sequence: u16,
    /// Number of the first sample since start, counted at the sample rate.
    pub first_sample: u32,
    /// Values per sample: 3 (accelerometer), 6 (and gyroscope) or 9 (and magnetometer).
    pub axes: u8,
    /// Physical value of one count: m/s², deg/s, µT.
    pub scale: [f32; 3],
    /// Little-endian i16, sample after sample, axes in the order accelerometer, gyroscope, magnetometer.
    #[serde(borrow)]
    pub counts: Bytes<'a, RAW_COUNTS_MAX>,
}

/// One sample of a left hand's five channels, as its board judges it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct RawAdc {
    /// Board clock at the sample, wrapping after 49 days: a jump tells of samples that are missing.
    pub board_time_ms: u32,
    /// x, y, z, index, middle: each the sum of eight conversions of 10 bits, 0 to 8184.
    pub counts: [u16; 5],
}

/// Counters since start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct Status {
    /// Time since start.
    pub uptime_ms: u32,
    /// Samples that could not be taken or kept in time.
    pub dropped_samples: u32,
    /// Failed transfers to the sensor.
    pub sensor_errors: u32,
    /// Damaged frames received from the laptop.
    pub bad_frames: u32,
    /// Minimum free stack seen since start, in bytes.
    pub free_stack_bytes: u32,
    /// Share of time awake since the last status, in parts per thousand.
    pub load_permille: u16,
    /// What the board does.
    pub mode: Mode,
}

/// What a board does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub enum Mode {
    /// Names gestures (right hand), or sends the hand's state (left hand).
    #[default]
    Classify,
    /// Sends raw batches.
    Record,
    /// Sends status only.
    Idle,
}

/// What went wrong on a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct Fault {
    /// Time since start.
    pub uptime_ms: u32,
    /// What.
    pub kind: FaultKind,
    /// Depends on the kind: a register value, an address, a channel.
    pub detail: u32,
}

open_list! {
    /// Kinds of [`Fault`].
    FaultKind {
        /// The sensor does not answer; detail = bus address.
        SensorMissing = 0,
        /// The sensor is not the expected one; detail = its WHO_AM_I.
        SensorUnknown = 1,
        /// The board is a Rev2, which an image of version 0.1.0 did not support. Later ones do.
        BoardRev2 = 2,
        /// The bus was stuck and has been cleared.
        BusStuck = 3,
        /// The watchdog restarted the board.
        Watchdog = 4,
        /// The firmware panicked before this start.
        Panic = 5,
        /// The stored calibration was damaged; defaults are in use.
        CalibrationDamaged = 6,
        /// The stored model was damaged or does not fit; the compiled-in one is in use.
        ModelDamaged = 7,
        /// The running model reads a magnetometer and this board has none that may be used: no gesture comes from it;
        /// detail = axes of its sensor.
        NoMagnetometer = 8,
    }
}

/// Answer to a ping.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct Pong {
    /// The id of the ping.
    pub id: u32,
    /// Board clock when the ping was handled.
    pub board_time_ms: u32,
}

/// Answer to a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct Ack {
    /// The request's number.
    pub request: u16,
    /// How it went.
    pub result: AckResult,
    /// In a model transfer: the offset that the board wants next, in bytes. Else 0.
    pub next_offset: u32,
}

open_list! {
    /// How a request went.
    AckResult {
        /// Done.
        Ok = 0,
        /// Accepted, and it takes time: a second acknowledgement follows.
        Started = 1,
        /// Not now: another request is under way.
        Busy = 2,
        /// This board does not do that.
        Unsupported = 3,
        /// A value is outside its range.
        OutOfRange = 4,
        /// The hand did not hold still, or the pose cannot be right.
        Unsteady = 5,
        /// The model's recipe, axes, rate, window or size does not fit this image.
        ModelDoesNotFit = 6,
        /// The piece is not the one wanted next.
        WrongOffset = 7,
        /// The checksum differs.
        BadChecksum = 8,
        /// Flash or EEPROM did not take the data.
        StorageFailed = 9,
        /// Writes need a bonded link.
        NotBonded = 10,
    }
}

/// Steps of the left hand's calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub enum CalibrationStep {
    /// The hand is level and still.
    Neutral,
    /// Both fingers are straight.
    Rest,
    /// Both fingers are bent.
    Bend,
    /// Forget it all and use defaults.
    Reset,
}

/// What a model needs and names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct ModelInfo<'a> {
    /// CRC-32 of the blob.
    pub model_id: u32,
    /// How features are made (see `shared_dsp::right::kind`).
    pub recipe: u8,
    /// Values per sample.
    pub axes: u8,
    /// Samples per second.
    pub sample_hz: u16,
    /// Samples per window.
    pub window: u16,
    /// Names of the outputs in order, separated by commas.
    #[serde(borrow)]
    pub labels: Text<'a, LABELS_MAX>,
}

impl ModelBegin<'_> {
    /// [`ModelBegin::scaling`] of a model that boards run.
    pub const DATA_SHEET_SCALING: [f32; 3] = [1.0; 3];
}

/// Announces a model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, MaxSize)]
pub struct ModelBegin<'a> {
    /// Echoed in the [`Ack`].
    pub request: u16,
    /// What the model needs and names; `model_id` is the CRC-32 of the whole blob.
    #[serde(borrow)]
    pub info: ModelInfo<'a>,
    /// In which scale of accelerometer, gyroscope and magnetometer the model was trained, as a factor on the data sheets'.
    /// Arduino's library reads 1.1469 too much on two of them. Boards compute in data sheets' scale and refuse a model of
    /// another one: its gestures would be recognised at another tempo.
    pub scaling: [f32; 3],
    /// Bytes of the whole blob.
    pub size: u32,
}
