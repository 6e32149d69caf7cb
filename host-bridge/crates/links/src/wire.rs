//! A byte stream in virtual time, which delays bytes and delivers them in portions of any size.

use std::collections::VecDeque;

/// Bytes per millisecond of a serial line at 115200 baud, 8N1.
pub const SERIAL_115200: f64 = 11.52;

/// One direction of a link.
#[derive(Clone, Debug)]
pub struct Pipe {
    bytes_per_ms: f64,
    credit: f64,
    queue: VecDeque<u8>,
}

impl Pipe {
    /// Creates an empty pipe with this speed.
    pub fn new(bytes_per_ms: f64) -> Self {
        Pipe { bytes_per_ms, credit: 0.0, queue: VecDeque::new() }
    }

    /// Puts bytes in.
    pub fn write(&mut self, bytes: &[u8]) {
        self.queue.extend(bytes);
    }

    /// Advances by one millisecond, and appends the bytes that arrive in it to `out`.
    pub fn step(&mut self, out: &mut Vec<u8>) {
        self.credit += self.bytes_per_ms;
        let count = (self.credit as usize).min(self.queue.len());
        out.extend(self.queue.drain(..count));
        // An idle line accumulates no more than a fraction of a byte.
        self.credit = (self.credit - count as f64).min(1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_arrive_in_order_at_the_pace_of_the_line() {
        let mut pipe = Pipe::new(SERIAL_115200);
        let sent: Vec<u8> = (0..=255).collect();
        let mut got = Vec::new();
        for _ in 0..100 {
            pipe.step(&mut got);
        }
        pipe.write(&sent);
        let mut passed_ms = 0;
        while got.len() < sent.len() {
            let before = got.len();
            pipe.step(&mut got);
            assert!(got.len() - before <= 13);
            passed_ms += 1;
        }
        assert_eq!(got, sent);
        assert_eq!(passed_ms, 23); // 256 / 11.52 = 22.2
    }
}
