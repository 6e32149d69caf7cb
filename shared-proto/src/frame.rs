//! Frames: converts messages to bytes that survive a noisy line, and converts them back.
//!
//! The format is `COBS(postcard(message) ++ CRC-32 little endian) ++ 0x00`.
//! The zero byte occurs only at the end, so a receiver that has lost its place waits for the next zero.
//!
//! Every complete frame after a zero byte (or at the start of a new [`Decoder`]) is accepted, whatever precedes it.
//! A sender therefore writes one [`DELIMITER`] after each start or opened link, to terminate a partial frame or noise.
//! The additional delimiter is harmless, because empty frames are skipped.
//! Damaged frames are counted and dropped, and never requested again.

use crate::crc::Crc32;
use crate::message::{BoardBody, BoardMessage, HostMessage, LeftRequest, Row, largest};
use postcard::ser_flavors::Flavor;
use serde::Serialize;

/// The byte that ends each frame and occurs nowhere else in it.
pub const DELIMITER: u8 = 0;

const CRC_BYTES: usize = 4;

/// Length of a frame: `message` bytes, the checksum, one code byte for each started block of 254 bytes, and the delimiter.
pub(crate) const fn frame_len(message: usize) -> usize {
    let decoded = message + CRC_BYTES;
    decoded + decoded / 254 + 1 + 1
}

/// Largest frame from any board in bytes, which is the size of the laptop's receive buffer.
pub const BOARD_FRAME_MAX: usize = largest(BoardMessage::ROWS, false);
/// Largest frame from the left board in bytes, which is the size of its send buffer.
pub const LEFT_BOARD_FRAME_MAX: usize = largest(BoardMessage::ROWS, true);
/// Largest frame from the laptop to a left board in bytes, which is the size of that board's receive buffer.
/// Longer frames contain models, which are not for this board. The board counts them as overflow.
pub const HOST_TO_LEFT_FRAME_MAX: usize = largest(HostMessage::ROWS, true);
/// Largest frame from the laptop in bytes, which is the size of the right board's receive buffer.
pub const HOST_FRAME_MAX: usize = largest(HostMessage::ROWS, false);

/// The caller's buffer is too small for the frame.
///
/// If the buffer has [`BoardBody::FRAME_MAX`] bytes,
/// a text or list in the message exceeds its maximum length.
/// See [`message`](crate::message).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EncodeError;

impl core::fmt::Display for EncodeError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("the message does not fit the frame buffer: shorten its text or list")
    }
}

impl core::error::Error for EncodeError {}

/// Writes the frame of a board's message to `out` and returns the written part.
///
/// # Errors
/// Returns an [`EncodeError`] if `out` is too small; its content is then undefined.
pub fn encode_board<'b>(message: &BoardMessage<'_>, out: &'b mut [u8]) -> Result<&'b [u8], EncodeError> {
    encode(message, out)
}

/// Writes the frame of a laptop's message to `out` and returns the written part.
///
/// # Errors
/// Returns an [`EncodeError`] if `out` is too small; its content is then undefined.
pub fn encode_host<'b>(message: &HostMessage<'_>, out: &'b mut [u8]) -> Result<&'b [u8], EncodeError> {
    encode(message, out)
}

/// Writes the same frame as [`encode_board`], but needs only the body of the message.
///
/// The function saves flash on boards, because the program contains code only for the bodies that it sends.
///
/// # Errors
/// Returns an [`EncodeError`] if `out` is too small; its content is then undefined.
pub fn encode_body<'b, B: BoardBody>(body: &B, out: &'b mut [u8]) -> Result<&'b [u8], EncodeError> {
    // A message's number is one byte on the wire, because there are fewer than 128.
    encode(&(B::NUMBER, body), out)
}

fn encode<'b>(message: &impl Serialize, out: &'b mut [u8]) -> Result<&'b [u8], EncodeError> {
    postcard::serialize_with_flavor(message, FrameWriter::new(out)).map_err(|_| EncodeError)
}

/// Encodes COBS and computes the checksum while postcard writes, so that a frame needs only one buffer and one pass.
struct FrameWriter<'b> {
    out: &'b mut [u8],
    /// Number of bytes written, including the open code byte.
    len: usize,
    /// Position of the code byte of the open block.
    code_at: usize,
    crc: Crc32,
    /// Whether any data did not fit in the buffer.
    /// The flag is checked only at the end. A check after each byte would cost the left board 1 KB of flash.
    full: bool,
}

impl<'b> FrameWriter<'b> {
    fn new(out: &'b mut [u8]) -> Self {
        Self { out, len: 1, code_at: 0, crc: Crc32::new(), full: false }
    }

    fn put(&mut self, at: usize, byte: u8) {
        match self.out.get_mut(at) {
            Some(place) => *place = byte,
            None => self.full = true,
        }
    }

    fn close_block(&mut self) {
        // The code is at most 255, because a block is closed as soon as it contains 254 bytes.
        let code = (self.len - self.code_at) as u8;
        self.put(self.code_at, code);
    }

    fn open_block(&mut self) {
        self.code_at = self.len;
        self.len += 1;
    }

    fn stuff(&mut self, byte: u8) {
        // A full block is closed only if more bytes follow, so that the frame does not end with an empty block.
        if self.len - self.code_at == 255 {
            self.close_block();
            self.open_block();
        }
        if byte == 0 {
            self.close_block();
            self.open_block();
        } else {
            self.put(self.len, byte);
            self.len += 1;
        }
    }
}

impl<'b> Flavor for FrameWriter<'b> {
    type Output = &'b [u8];

    // This function is not inlined, because a copy for each field of each message would cost the left board several KB.
    #[inline(never)]
    fn try_push(&mut self, byte: u8) -> postcard::Result<()> {
        self.crc.update(&[byte]);
        self.stuff(byte);
        Ok(())
    }

    fn finalize(mut self) -> postcard::Result<&'b [u8]> {
        for byte in self.crc.finish().to_le_bytes() {
            self.stuff(byte);
        }
        self.close_block();
        self.put(self.len, DELIMITER);
        let whole = if self.full { None } else { self.out.get(..=self.len) };
        whole.ok_or(postcard::Error::SerializeBufferFull)
    }
}

/// The reason why the payload of an intact frame is not a message that this version knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParseError {
    /// A later minor version added this message. Ignore it.
    Unknown,
    /// The message is known but has another layout, so the sender has another major version.
    Malformed,
}

impl core::fmt::Display for ParseError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Unknown => "a message that a later minor version added",
            Self::Malformed => "a message of another major version",
        })
    }
}

impl core::error::Error for ParseError {}

/// Parses a board's message from the payload of an intact frame.
///
/// Extra bytes after the message make it [`ParseError::Malformed`].
/// [`Hello`](BoardMessage::Hello) is an exception: its fields are frozen, but later versions may append to it.
///
/// # Errors
/// Returns a [`ParseError`] if this version does not have such a message.
pub fn parse_board(payload: &[u8]) -> Result<BoardMessage<'_>, ParseError> {
    match postcard::take_from_bytes(payload) {
        Ok((message, rest)) if rest.is_empty() || matches!(message, BoardMessage::Hello(_)) => Ok(message),
        _ => Err(why_not(payload, BoardMessage::ROWS)),
    }
}

/// Parses a laptop's message from the payload of an intact frame.
///
/// Extra bytes after the message make it [`ParseError::Malformed`].
/// [`HelloRequest`](HostMessage::HelloRequest) is an exception, for the same reason as in [`parse_board`].
///
/// # Errors
/// Returns a [`ParseError`] if this version does not have such a message.
pub fn parse_host(payload: &[u8]) -> Result<HostMessage<'_>, ParseError> {
    match postcard::take_from_bytes(payload) {
        Ok((message, rest)) if rest.is_empty() || message == HostMessage::HelloRequest => Ok(message),
        _ => Err(why_not(payload, HostMessage::ROWS)),
    }
}

/// Parses a laptop's message to a left board. Messages that only the right board knows are [`ParseError::Unknown`].
/// For all other messages, the function behaves like [`parse_host`] with much less code.
///
/// # Errors
/// Returns a [`ParseError`] if this version does not have such a message for a left board.
pub fn parse_left_request(payload: &[u8]) -> Result<LeftRequest, ParseError> {
    match LeftRequest::take(payload)? {
        (message, rest) if rest.is_empty() || message == LeftRequest::HelloRequest => Ok(message),
        _ => Err(ParseError::Malformed),
    }
}

fn why_not(payload: &[u8], known: &[Row]) -> ParseError {
    match payload.first() {
        Some(&number) if usize::from(number) >= known.len() => ParseError::Unknown,
        _ => ParseError::Malformed,
    }
}

/// Statistics of a [`Decoder`] since its creation. All counters wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Number of intact frames, with known or unknown messages.
    pub frames: u32,
    /// Number of intact frames whose message was added by a later minor version.
    pub unknown: u32,
    /// Number of intact frames whose message has another layout, so the sender has another major version.
    pub malformed: u32,
    /// Number of damaged frames whose delimiter came too early or too late.
    pub bad_cobs: u32,
    /// Number of damaged frames whose checksum is wrong or missing.
    pub bad_crc: u32,
    /// Number of frames that are longer than the buffer.
    /// Such a frame is damaged or meant for another receiver.
    pub overflow: u32,
}

impl Counters {
    /// Number of frames lost on the line, as reported in [`Status::bad_frames`](crate::message::Status).
    pub fn damaged(&self) -> u32 {
        self.bad_cobs.wrapping_add(self.bad_crc).wrapping_add(self.overflow)
    }
}

/// Converts bytes to messages. The bytes may arrive in portions of any size.
///
/// `N` is the maximum length of a frame in bytes on the wire, such as [`BOARD_FRAME_MAX`].
/// The decoder itself needs `N` bytes plus about 30.
#[derive(Clone, Debug)]
pub struct Decoder<const N: usize> {
    buffer: [u8; N],
    /// Number of decoded bytes in `buffer`.
    len: usize,
    /// The code byte of the open block, or 0 before the first block of a frame.
    code: u8,
    /// Number of bytes of the open block that are still to come.
    left: u8,
    /// Whether the frame is longer than the buffer, so that all bytes up to the delimiter are skipped.
    skipping: bool,
    counters: Counters,
}

impl<const N: usize> Default for Decoder<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Decoder<N> {
    /// Creates a decoder that expects the start of a frame.
    pub const fn new() -> Self {
        Self {
            buffer: [0; N],
            len: 0,
            code: 0,
            left: 0,
            skipping: false,
            counters: Counters { frames: 0, unknown: 0, malformed: 0, bad_cobs: 0, bad_crc: 0, overflow: 0 },
        }
    }

    /// Returns the statistics so far.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// Adds one byte. Returns the payload (the message without its checksum) if the byte completes an intact frame.
    pub fn push(&mut self, byte: u8) -> Option<&[u8]> {
        let len = self.step(byte)?;
        Some(&self.buffer[..len])
    }

    /// Adds one byte on the laptop. Returns a message if the byte completes an intact frame with a known message.
    pub fn push_board(&mut self, byte: u8) -> Option<BoardMessage<'_>> {
        let len = self.step(byte)?;
        let parsed = parse_board(&self.buffer[..len]);
        Self::count_unparsed(&mut self.counters, parsed)
    }

    /// Adds one byte on a board. Returns a message if the byte completes an intact frame with a known message.
    pub fn push_host(&mut self, byte: u8) -> Option<HostMessage<'_>> {
        let len = self.step(byte)?;
        let parsed = parse_host(&self.buffer[..len]);
        Self::count_unparsed(&mut self.counters, parsed)
    }

    /// Adds one byte on a left board. Returns a request if the byte completes an intact frame with a known request.
    pub fn push_left_request(&mut self, byte: u8) -> Option<LeftRequest> {
        let len = self.step(byte)?;
        let parsed = parse_left_request(&self.buffer[..len]);
        Self::count_unparsed(&mut self.counters, parsed)
    }

    fn count_unparsed<M>(counters: &mut Counters, parsed: Result<M, ParseError>) -> Option<M> {
        let counter = match parsed {
            Ok(message) => return Some(message),
            Err(ParseError::Unknown) => &mut counters.unknown,
            Err(ParseError::Malformed) => &mut counters.malformed,
        };
        *counter = counter.wrapping_add(1);
        None
    }

    /// Adds one byte. Returns the payload's length in `buffer` if the byte completes an intact frame.
    fn step(&mut self, byte: u8) -> Option<usize> {
        if byte == DELIMITER {
            let ended = self.end_frame();
            self.len = 0;
            self.code = 0;
            self.left = 0;
            self.skipping = false;
            return ended;
        }
        if self.skipping {
            return None;
        }
        if self.left > 0 {
            self.left -= 1;
            self.keep(byte);
        } else {
            // A new block begins. The previous block ended in a zero unless that block was full or this is the first block.
            if self.code != 0 && self.code != 255 {
                self.keep(0);
            }
            self.code = byte;
            self.left = byte - 1;
        }
        None
    }

    fn keep(&mut self, byte: u8) {
        match self.buffer.get_mut(self.len) {
            Some(place) => {
                *place = byte;
                self.len += 1;
            }
            None => self.skipping = true,
        }
    }

    fn end_frame(&mut self) -> Option<usize> {
        let counter = if self.skipping {
            &mut self.counters.overflow
        } else if self.code == 0 {
            return None; // two delimiters in a row
        } else if self.left > 0 {
            &mut self.counters.bad_cobs
        } else {
            match self.len.checked_sub(CRC_BYTES) {
                // A message is never empty. The checksum of an empty message is 0, which a line stuck at 0x01 would also produce.
                Some(len)
                    if len > 0
                        && Crc32::of(&self.buffer[..len]).to_le_bytes() == self.buffer[len..self.len] =>
                {
                    self.counters.frames = self.counters.frames.wrapping_add(1);
                    return Some(len);
                }
                _ => &mut self.counters.bad_crc,
            }
        };
        *counter = counter.wrapping_add(1);
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{LeftState, Mode};

    #[test]
    fn a_message_comes_back_from_its_frame() {
        let mut buffer = [0; LeftState::FRAME_MAX];
        let sent = BoardMessage::Left(LeftState { sequence: 7, pitch_mrad: -300, ..Default::default() });
        let frame = encode_board(&sent, &mut buffer).unwrap();
        let mut decoder = Decoder::<{ LeftState::FRAME_MAX }>::new();
        let (last, first) = frame.split_last().unwrap();
        for &byte in first {
            assert_eq!(decoder.push_board(byte), None);
        }
        assert_eq!(decoder.push_board(*last), Some(sent));
        assert_eq!(decoder.counters(), Counters { frames: 1, ..Default::default() });
    }

    #[test]
    fn a_frame_is_taken_whatever_noise_stands_before_its_delimiter() {
        let mut buffer = [0; HOST_TO_LEFT_FRAME_MAX];
        let sent = HostMessage::SetMode { request: 9, mode: Mode::Record };
        let frame = encode_host(&sent, &mut buffer).unwrap();
        let mut decoder = Decoder::<HOST_TO_LEFT_FRAME_MAX>::new();
        for _ in 0..1000 {
            assert_eq!(decoder.push(0x55), None);
        }
        assert_eq!(decoder.push(DELIMITER), None);
        let mut seen = 0;
        for &byte in frame {
            if let Some(message) = decoder.push_host(byte) {
                assert_eq!(message, sent);
                seen += 1;
            }
        }
        assert_eq!(seen, 1);
        assert_eq!(decoder.counters(), Counters { frames: 1, overflow: 1, ..Default::default() });
    }
}
