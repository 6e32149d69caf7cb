//! Recordings that behave like boards: raw samples in, frames out, through the very code that boards run.

mod left;
mod right;
mod wired;

pub use left::{LeftBoard, heading_on_the_wire};
pub use right::{ModelFile, ModelFileError, RightBoard, join, model_info_on_the_wire};
pub use wired::Wired;

use shared_proto::frame::{BOARD_FRAME_MAX, DELIMITER, Decoder, HOST_FRAME_MAX, encode_board};
use shared_proto::message::{BoardMessage, HostMessage, Pong};

use host_core::observe::Sample;

/// A board in virtual time: on the wire it looks like a real one. Its clock starts with the session.
pub trait Board {
    /// Lets the time become `now_ms`; the bytes sent meanwhile are appended to `wire`.
    fn step(&mut self, now_ms: u64, wire: &mut Vec<u8>);

    /// Takes bytes from the laptop; answers are appended to `wire`.
    fn receive(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>);

    /// The reading of its sensors that it took in the last step, if any, for observers.
    fn sample(&self) -> Option<Sample<'_>> {
        None
    }

    /// The recording is over: the board is silent from now on.
    fn ended(&self) -> bool;
}

/// The sending end that both hands share.
#[derive(Clone, Debug, Default)]
struct Port {
    decoder: Decoder<HOST_FRAME_MAX>,
    opened: bool,
}

impl Port {
    fn send(&mut self, message: &BoardMessage<'_>, wire: &mut Vec<u8>) {
        if !self.opened {
            // Ends whatever noise the opening of the line has left in the receiver.
            self.opened = true;
            wire.push(DELIMITER);
        }
        let mut buffer = [0; BOARD_FRAME_MAX];
        // Texts and lists are cut to their maxima before: every message fits.
        if let Ok(frame) = encode_board(message, &mut buffer) {
            wire.extend_from_slice(frame);
        }
    }

    /// Takes the laptop's bytes and answers pings; true when it asks who is there.
    fn is_asked_for_hello(&mut self, bytes: &[u8], now_ms: u64, wire: &mut Vec<u8>) -> bool {
        let mut asked = false;
        for &byte in bytes {
            match self.decoder.push_host(byte) {
                Some(HostMessage::HelloRequest) => asked = true,
                Some(HostMessage::Ping { id }) => {
                    self.send(&BoardMessage::Pong(Pong { id, board_time_ms: now_ms as u32 }), wire);
                }
                _ => {}
            }
        }
        asked
    }
}
