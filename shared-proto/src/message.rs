//! All messages on the wire, in one table for each direction.
//!
//! A row is `number Name fields => boards, minor version that added it`.
//! The macro derives everything else about a message from its row: the place in the enum, the buffer sizes in
//! [`frame`](crate::frame), and the messages of a left board ([`LeftRequest`]).
//! Tests also compare the rows in `WIRE.md` and the golden frames with [`BoardMessage::ROWS`]
//! and [`HostMessage::ROWS`].
//!
//! A message is a [postcard](https://postcard.jamesmunns.com/wire-format) enum: a variant number of one byte, and fields.
//! States are sent completely, and events are wrapping counters, so that lost and repeated frames do no harm.
//!
//! A new message at the end of a table is a minor change, and so is a new value in a list that has `Unknown`.
//! These lists include [`Board`], [`FaultKind`] and [`AckResult`].
//! Every other change is a major change (see [`PROTOCOL_MAJOR`]).
//! [`Hello`] and [`HostMessage::HelloRequest`] never change, so any two versions can detect that they differ.

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

/// The major version increases when the layout of a message changes. Both sides must have the same number.
pub const PROTOCOL_MAJOR: u8 = 1;
/// This number increases when a message is added. The older side ignores messages that it does not know.
pub const PROTOCOL_MINOR: u8 = 7;

board_messages! {
    /// Messages from a board to the laptop.
    BoardMessage<'a> {
        /// The board sends this at start, and in answer to [`HostMessage::HelloRequest`].
        #[serde(borrow)]
        0 Hello(Hello<'a>) => Both, 0;
        /// The complete state of the left hand, which is sent at 50 Hz and immediately after a change.
        1 Left(LeftState) => Left, 0;
        /// The complete state of the right hand, which is sent once per hop (80 ms).
        #[serde(borrow)]
        2 Right(RightState<'a>) => Right, 0;
        /// The samples that entered the window. The board sends them only in record mode.
        #[serde(borrow)]
        3 RawImu(RawImu<'a>) => Right, 0;
        /// Counters, once per second.
        4 Status(Status) => Both, 0;
        /// A problem that the user must know about.
        5 Fault(Fault) => Both, 0;
        /// Answer to [`HostMessage::Ping`].
        6 Pong(Pong) => Both, 0;
        /// The answer to every other request.
        7 Ack(Ack) => Both, 0;
        /// The requirements and labels of the running model.
        /// A right hand's board sends this message after each hello.
        #[serde(borrow)]
        8 ModelInfo(ModelInfo<'a>) => Right, 0;
        /// The hardware of a right hand's board. The board sends this message after each hello.
        9 About(About) => Right, 1;
        /// One sample of a left hand's converter. The board sends it only in record mode.
        10 RawAdc(RawAdc) => Left, 3;
        /// The mean acceleration of one hop, from which a laptop computes the tilt of the right hand.
        /// The board sends it after each state, but only once [`HostMessage::SetThresholds`] has requested it.
        11 Tilt(RightTilt) => Right, 6;
        /// How a laptop pairs or has paired with the board over Bluetooth.
        12 Pairing(Pairing) => Both, 7;
    }
}

host_messages! {
    /// Messages from the laptop to a board.
    HostMessage<'a> {
        /// Asks for a [`Hello`].
        0 HelloRequest => Both, 0;
        /// The receiver answers with [`Pong`], which contains the same id.
        1 Ping {
            /// Chosen by the laptop.
            id: u32,
        } => Both, 0;
        /// Changes the mode of the board.
        2 SetMode {
            /// Echoed in the [`Ack`].
            request: u16,
            /// The new mode.
            mode: Mode,
        } => Both, 0;
        /// Starts one step of the left hand's calibration.
        3 Calibrate {
            /// Echoed in the [`Ack`].
            request: u16,
            /// The pose in which the hand is held.
            step: CalibrationStep,
        } => Both, 0;
        /// Changes the left hand's tilt thresholds until the next restart.
        /// A right hand's board since 1.6 sends [`RightTilt`] until the next restart; older ones refuse the request.
        4 SetThresholds {
            /// Echoed in the [`Ack`].
            request: u16,
            /// The new thresholds.
            thresholds: TiltThresholds,
        } => Both, 0;
        /// Announces a model blob. The board answers with the next expected offset.
        #[serde(borrow)]
        5 ModelBegin(ModelBegin<'a>) => Right, 0;
        /// A piece of the blob. Pieces must arrive in order; the [`Ack`] contains the next expected offset.
        6 ModelChunk {
            /// Echoed in the [`Ack`].
            request: u16,
            /// Offset of the data in the blob, in bytes.
            offset: u32,
            /// A piece of the blob.
            #[serde(borrow)]
            data: Bytes<'a, MODEL_CHUNK_MAX>,
        } => Right, 0;
        /// Verifies and stores the blob, which is used after the next restart.
        7 ModelCommit {
            /// Echoed in the [`Ack`].
            request: u16,
            /// CRC-32 of the complete blob. The same number is the new model id.
            crc32: u32,
        } => Right, 0;
        /// Plays a signal on a motor at the right hand's board, if one is connected.
        /// The board sends no acknowledgement, because a late signal is useless. Older boards ignore it.
        8 Feel {
            /// The signal to play.
            signal: Signal,
        } => Right, 2;
        /// Announces a new image for the board. Its pieces follow as [`HostMessage::ModelChunk`].
        /// A [`HostMessage::ModelCommit`] then restarts the board, which installs the image.
        9 ImageBegin {
            /// Echoed in the [`Ack`].
            request: u16,
            /// Size of the image's file in bytes.
            size: u32,
            /// CRC-32 of the file.
            crc32: u32,
        } => Right, 5;
        /// Asks whether the image of this file is running. If so, the board makes the image permanent.
        10 ImageConfirm {
            /// Echoed in the [`Ack`].
            request: u16,
            /// CRC-32 of the file.
            crc32: u32,
        } => Right, 5;
    }
}

/// Maximum size of a model's piece in one frame, in bytes. All pieces except the last have this size.
pub const MODEL_CHUNK_MAX: usize = 128;
/// Maximum size of [`RawImu::counts`] in bytes, for 8 samples of 9 axes.
pub const RAW_COUNTS_MAX: usize = 8 * 9 * 2;
/// Maximum size of [`ModelInfo::labels`] in bytes of UTF-8, with the commas.
pub const LABELS_MAX: usize = 96;
/// Maximum size of [`RightState::scores`], which is the maximum number of labels.
pub const SCORES_MAX: usize = 32;
/// Maximum size of [`Hello::firmware`] in bytes of UTF-8.
pub const FIRMWARE_MAX: usize = 32;

/// The complete state of the left hand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct LeftState {
    /// Sequence number, which increases by one with each frame of this message, and wraps.
    pub sequence: u16,
    /// Time of the newest sample in this state on the board's clock, which wraps after 49 days.
    pub board_time_ms: u32,
    /// Tilt about the lateral axis in milliradians, positive = forward.
    pub pitch_mrad: i16,
    /// Tilt about the forward axis in milliradians, positive = left.
    pub roll_mrad: i16,
    /// The debounced heading that follows from the tilt.
    pub heading: Heading,
    /// Number of bends of the index finger since the start. The number wraps.
    pub index_bends: u8,
    /// Number of bends of the middle finger since the start. The number wraps.
    pub middle_bends: u8,
    /// Both fingers have been held bent for 300 ms.
    pub stop: bool,
    /// Bits of [`health`]; 0 means no problem.
    pub health: u8,
}

/// The complete state of the right hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct RightState<'a> {
    /// Sequence number, which increases by one with each frame of this message, and wraps.
    pub sequence: u16,
    /// Time of the window's newest sample on the board's clock, which wraps after 49 days.
    pub board_time_ms: u32,
    /// Number of gestures that were performed since the start. The number wraps.
    pub events: u8,
    /// Index of the last event's gesture in the model's labels; 255 before the first event.
    pub label: u8,
    /// Confidence of the last event, where 0 to 255 means 0 to 1.
    pub confidence: u8,
    /// Time on the board's clock at the end of the window that triggered the last event.
    pub event_window_end_ms: u32,
    /// The network's int8 outputs as bytes, one per label: (score + 128) / 256 is the probability.
    #[serde(borrow)]
    pub scores: Bytes<'a, SCORES_MAX>,
    /// Bits of [`health`]; 0 means no problem.
    pub health: u8,
}

/// Samples exactly as they entered the window, as i16 counts on the 100 Hz grid.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, MaxSize)]
pub struct RawImu<'a> {
    /// Sequence number, which increases by one with each frame of this message, and wraps.
    pub sequence: u16,
    /// Number of the first sample since start, counted at the sample rate.
    pub first_sample: u32,
    /// Number of values per sample: 3 (accelerometer), 6 (with gyroscope) or 9 (with magnetometer).
    pub axes: u8,
    /// Physical value of one count in m/s², deg/s and µT.
    pub scale: [f32; 3],
    /// Little-endian i16 counts, one sample after another. The axes are in the order accelerometer, gyroscope, magnetometer.
    #[serde(borrow)]
    pub counts: Bytes<'a, RAW_COUNTS_MAX>,
}

/// One sample of a left hand's five channels, in the form in which the board uses it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct RawAdc {
    /// Time of the sample on the board's clock, which wraps after 49 days. A jump means that samples are missing.
    pub board_time_ms: u32,
    /// Values of x, y, z, index and middle. Each is the sum of eight conversions of 10 bits, 0 to 8184.
    pub counts: [u16; 5],
}

/// The mean of the acceleration over the hop of a [`RightState`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct RightTilt {
    /// Sequence number of the state of the same hop, which precedes this message and contains the time and the health.
    pub sequence: u16,
    /// Mean along the x, y and z axes of the board. An axis that points up reads +9807 at rest.
    pub acceleration_mm_s2: [i16; 3],
}

/// Pairing over Bluetooth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct Pairing {
    /// What the message says.
    pub kind: PairingKind,
    /// The six digits to type at the laptop that pairs; 0 for other kinds than [`PairingKind::Passkey`].
    pub passkey: u32,
}

open_list! {
    /// Kinds of [`Pairing`].
    PairingKind {
        /// A laptop pairs, and its owner must type the passkey there.
        /// The board sends this every second over its cables, and never over Bluetooth.
        Passkey = 0,
        /// This Bluetooth link was paired by "just works": nobody compared or typed a number.
        /// An attacker nearby may have answered in place of the laptop or the board.
        JustWorks = 1,
        /// This Bluetooth link was paired with a passkey.
        PasskeyTyped = 2,
    }
}

/// Counters since start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct Status {
    /// Time since start.
    pub uptime_ms: u32,
    /// Number of samples that could not be taken or stored in time.
    pub dropped_samples: u32,
    /// Number of failed transfers to the sensor.
    pub sensor_errors: u32,
    /// Number of damaged frames that arrived from the laptop.
    pub bad_frames: u32,
    /// Minimum free stack since start, in bytes.
    pub free_stack_bytes: u32,
    /// Share of the time since the last status in which the processor was awake, in parts per thousand.
    pub load_permille: u16,
    /// The mode of the board.
    pub mode: Mode,
}

/// The mode of a board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub enum Mode {
    /// Recognises gestures (right hand), or sends the hand's state (left hand).
    #[default]
    Classify,
    /// Sends raw batches.
    Record,
    /// Sends status only.
    Idle,
}

/// A problem on a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct Fault {
    /// Time since start.
    pub uptime_ms: u32,
    /// The kind of problem.
    pub kind: FaultKind,
    /// The meaning depends on the kind of fault: a register value, an address, or a channel.
    pub detail: u32,
}

open_list! {
    /// Kinds of [`Fault`].
    FaultKind {
        /// The sensor does not answer; the detail is its bus address.
        SensorMissing = 0,
        /// The sensor is not the expected sensor; the detail is its WHO_AM_I value.
        SensorUnknown = 1,
        /// The board is a Rev2, which images of version 0.1.0 did not support. Later images do.
        BoardRev2 = 2,
        /// The bus was blocked and has been cleared.
        BusStuck = 3,
        /// The watchdog restarted the board.
        Watchdog = 4,
        /// The firmware panicked before this start.
        Panic = 5,
        /// The stored calibration was damaged, so the default is used.
        CalibrationDamaged = 6,
        /// The stored model was damaged or cannot run on this image, so the compiled-in model is used.
        ModelDamaged = 7,
        /// The running model reads a magnetometer that this board does not have, so no gesture is recognised.
        /// The detail is the sensor's number of axes.
        NoMagnetometer = 8,
    }
}

/// Answer to a ping.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct Pong {
    /// The id of the ping.
    pub id: u32,
    /// Time on the board's clock when the ping was processed.
    pub board_time_ms: u32,
}

/// Answer to a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct Ack {
    /// The request's number.
    pub request: u16,
    /// The result of the request.
    pub result: AckResult,
    /// The next expected offset of a model transfer in bytes; otherwise 0.
    pub next_offset: u32,
}

open_list! {
    /// The result of a request.
    AckResult {
        /// The request was executed.
        Ok = 0,
        /// The board has accepted the request but needs time. A second acknowledgement follows.
        Started = 1,
        /// The board is busy with another request.
        Busy = 2,
        /// This board does not support the request.
        Unsupported = 3,
        /// A value is out of range.
        OutOfRange = 4,
        /// The hand moved, or its pose is implausible.
        Unsteady = 5,
        /// The model's recipe, axes, rate, window or size does not fit this image.
        ModelDoesNotFit = 6,
        /// The offset of the model's piece is not the expected offset.
        WrongOffset = 7,
        /// The checksum differs.
        BadChecksum = 8,
        /// Flash or EEPROM did not store the data.
        StorageFailed = 9,
        /// Writes need a bonded link.
        NotBonded = 10,
        /// The board refused the image, because the image is for another board or its signature is invalid.
        ImageRefused = 11,
        /// The board restored its old image, because the new image did not say hello before a restart.
        ImageWentBack = 12,
    }
}

/// The steps of the left hand's calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub enum CalibrationStep {
    /// The hand is level and still.
    Neutral,
    /// Both fingers are straight.
    Rest,
    /// Both fingers are bent.
    Bend,
    /// Deletes the calibration, so that the default is used.
    Reset,
}

/// The requirements and labels of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct ModelInfo<'a> {
    /// CRC-32 of the blob.
    pub model_id: u32,
    /// The kind of features (see `shared_dsp::right::kind`).
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
    /// [`ModelBegin::scaling`] of models that boards can run.
    pub const DATA_SHEET_SCALING: [f32; 3] = [1.0; 3];
}

/// Announces a model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, MaxSize)]
pub struct ModelBegin<'a> {
    /// Echoed in the [`Ack`].
    pub request: u16,
    /// The requirements and labels of the model; `model_id` is the CRC-32 of the complete blob.
    #[serde(borrow)]
    pub info: ModelInfo<'a>,
    /// The sensor scale that was used in training, as a multiple of the data sheets' scale.
    /// The values are for accelerometer, gyroscope and magnetometer.
    /// For two of the sensors, Arduino's library uses a factor of 1.1469.
    /// Boards use the data sheets' scale and refuse models with another scale.
    /// With such a model, gestures would need another tempo.
    pub scaling: [f32; 3],
    /// Length of the complete blob in bytes.
    pub size: u32,
}
