//! Simulates the Bluetooth of a laptop with its operating system and our bridge.
//! The laptop connects again and again.
//! It encrypts with stored keys or pairs, requests a large MTU and subscribes.
//! After that, it exchanges frames.

use super::board::Board;
use super::softdevice::central::{Command, Happening};

/// The MTU that Linux requests.
const MTU: u16 = 517;
/// Maximum length of a write before the MTU is known.
const SMALLEST_WRITE: usize = 20;

/// The laptop's side of a Bluetooth link. Frames are the same bytes as on a UART, split according to the MTU.
#[derive(Clone, Debug)]
pub struct BleHost {
    /// Whether a laptop without keys pairs.
    pub pairs: bool,
    /// Whether the laptop stores the keys of a pairing.
    pub bonds: bool,
    seen: usize,
    taken: usize,
    room: usize,
    ready: bool,
}

impl Default for BleHost {
    fn default() -> Self {
        Self { pairs: true, bonds: true, seen: 0, taken: 0, room: SMALLEST_WRITE, ready: false }
    }
}

impl BleHost {
    /// Begins to search for the board.
    pub fn connect(&mut self, board: &mut Board) {
        board.softdevice().central.connects = true;
    }

    /// Reacts to events since the last call; call it every few milliseconds.
    pub fn step(&mut self, board: &mut Board) {
        let central = &mut board.softdevice().central;
        for index in self.seen..central.log.len() {
            match central.log[index].1 {
                Happening::Connected(_) => {
                    (self.room, self.ready) = (SMALLEST_WRITE, false);
                    central.order([Command::ExchangeMtu(MTU), Command::FastRadio]);
                    if central.bond.is_some() {
                        central.order([Command::Encrypt]);
                    } else if self.pairs {
                        central.order([Command::Pair { bond: self.bonds }]);
                    }
                    central.order([Command::Subscribe(true)]);
                }
                // The board has deleted our keys, so the laptop pairs again.
                Happening::KeyMissing if self.pairs => {
                    central.commands.push_front(Command::Pair { bond: self.bonds });
                }
                Happening::Mtu(mtu) => self.room = usize::from(mtu) - 3,
                Happening::Subscribed(on) => self.ready = on,
                Happening::Disconnected(_) => self.ready = false,
                _ => {}
            }
        }
        self.seen = central.log.len();
    }

    /// Returns whether the link is ready for frames.
    pub fn is_ready(&self) -> bool {
        self.ready
    }

    /// Returns the notified bytes since the last call, with the cycle of their arrival.
    pub fn read(&mut self, board: &mut Board) -> Vec<(u64, u8)> {
        let now = board.now();
        let notified = &board.softdevice().central.notified;
        let here = notified[self.taken..].iter().take_while(|(at, _)| *at <= now).count();
        let new = &notified[self.taken..self.taken + here];
        self.taken += here;
        new.iter().flat_map(|(at, bytes)| bytes.iter().map(|&b| (*at, b))).collect()
    }

    /// Writes bytes in pieces that fit the MTU, without responses.
    pub fn send(&mut self, board: &mut Board, bytes: &[u8]) {
        let pieces = bytes.chunks(self.room).map(|piece| Command::WriteCommand(piece.to_vec()));
        board.softdevice().central.order(pieces);
    }
}
