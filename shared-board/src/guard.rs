//! Filters the packets that arrive over Bluetooth before the host stack receives them.
//!
//! The host stack `trouble-host` 0.8 does not check the lengths of requests.
//! A request that is too short makes it panic.
//! Without this filter, anybody in range could therefore restart the board, even without pairing.
//! The filter accepts only packets that a board uses, and only lengths that the Core Specification allows.
//! In its volume 3, part A describes L2CAP, part F describes ATT, and part H describes the security manager.

/// Number of bytes in an L2CAP header.
const HEADER: usize = 4;
/// Maximum length of the content, which is the largest MTU of the board.
const LONGEST: usize = 247;

const ATT: u16 = 4;
const SIGNALLING: u16 = 5;
const SECURITY: u16 = 6;

/// Checks the fragments that arrive on one link.
#[derive(Clone, Copy, Debug, Default)]
pub struct Guard {
    /// Number of bytes that are missing from the end of a packet whose beginning was accepted.
    left: usize,
}

impl Guard {
    /// Resets the filter, because another link begins.
    pub fn reset(&mut self) {
        self.left = 0;
    }

    /// Returns whether the host stack may receive this fragment, which begins or continues an L2CAP packet.
    pub fn passes(&mut self, starts: bool, fragment: &[u8]) -> bool {
        if !starts {
            return match self.left.checked_sub(fragment.len()) {
                Some(left) if !fragment.is_empty() => {
                    self.left = left;
                    true
                }
                _ => false,
            };
        }
        let [l0, l1, c0, c1, ref content @ ..] = *fragment else { return false };
        let length = usize::from(u16::from_le_bytes([l0, l1]));
        let Some(left) = length.checked_sub(content.len()).filter(|_| length <= LONGEST) else {
            return false;
        };
        let is_sound = match u16::from_le_bytes([c0, c1]) {
            ATT => is_att(content, length),
            SIGNALLING => is_signal(content, length),
            SECURITY => content.first().is_some_and(|&code| is_security(code, length)),
            _ => false,
        };
        // If the previous packet is incomplete, the host stack disconnects here.
        // No correct laptop causes this.
        if is_sound && self.left == 0 {
            self.left = left;
        }
        is_sound
    }

    /// Returns whether a packet has begun but not ended.
    pub fn is_waiting(&self) -> bool {
        self.left > 0
    }
}

/// Returns whether this is a sound request or command. The board sends no requests, so it expects no answers.
/// The host stack itself refuses all other packets.
fn is_att(content: &[u8], length: usize) -> bool {
    let [opcode, ref rest @ ..] = *content else { return false };
    match opcode {
        // The smallest MTU is 23.
        0x02 => length == 3 && matches!(*rest, [low, high] if u16::from_le_bytes([low, high]) >= 23),
        0x0A => length == 3,
        0x04 | 0x0C => length == 5,
        0x06 => length >= 7,
        // The host stack has no room for a group type of 16 bytes.
        0x10 => length == 7,
        0x08 => length == 7 || length == 21,
        // A request for several values contains at least two handles.
        0x0E | 0x20 => length >= 5 && length % 2 == 1,
        0x12 | 0x52 => length >= 3,
        0x16 => length >= 5,
        0x18 => length == 2,
        0x1E => length == 1,
        _ => opcode.is_multiple_of(2),
    }
}

/// Returns whether this packet is a laptop's refusal,
/// or its answer to a request for other connection parameters.
fn is_signal(content: &[u8], length: usize) -> bool {
    let [code, _, l0, l1, ..] = *content else { return false };
    let says = usize::from(u16::from_le_bytes([l0, l1]));
    says + HEADER == length && (code == 0x01 && says >= 2 || code == 0x13 && says == 2)
}

/// Returns whether the side that starts the pairing sends such a packet.
/// With Secure Connections, that side distributes no keys except those of its identity.
fn is_security(code: u8, length: usize) -> bool {
    let right = match code {
        0x01 => 7,
        0x03 | 0x04 | 0x08 | 0x0D => 17,
        0x05 | 0x0E => 2,
        0x09 => 8,
        0x0C => 65,
        _ => return false,
    };
    length == right
}

#[cfg(test)]
mod tests {
    use super::*;

    fn packet(channel: u16, content: &[u8]) -> std::vec::Vec<u8> {
        let mut packet = std::vec::Vec::from((content.len() as u16).to_le_bytes());
        packet.extend(channel.to_le_bytes());
        packet.extend(content);
        packet
    }

    fn passes(channel: u16, content: &[u8]) -> bool {
        Guard::default().passes(true, &packet(channel, content))
    }

    #[test]
    fn what_laptops_send_passes() {
        for att in [
            &[0x02, 5, 2][..],
            &[0x02, 23, 0],
            &[0x04, 1, 0, 255, 255],
            &[0x06, 1, 0, 255, 255, 0, 0x28, 1],
            &[0x08, 1, 0, 255, 255, 3, 0x28],
            &[0x0A, 3, 0],
            &[0x10, 1, 0, 255, 255, 0, 0x28],
            &[0x12, 10, 0, 1, 0],
            &[0x52, 12, 0],
            &[0x20, 3, 0, 5, 0],
            &[0x1E],
        ] {
            assert!(passes(ATT, att), "{att:?}");
        }
        assert!(passes(SIGNALLING, &[0x13, 1, 2, 0, 0, 0]));
        assert!(passes(SECURITY, &[1, 3, 0, 13, 16, 1, 1]));
        assert!(passes(SECURITY, &[0x0C; 65]));
    }

    #[test]
    fn short_long_empty_and_unasked_for_ones_do_not() {
        for att in [
            &[][..],
            &[0x02, 5],
            &[0x06, 1],
            &[0x0A],
            &[0x12, 1],
            &[0x52],
            &[0x18],
            &[0x02, 22, 0],
            &[0x20],
            &[0x20, 3],
            &[0x20, 3, 0],
            &[0x20, 3, 0, 5],
            &[0x01, 2, 3, 4, 5],
            &[0x10, 1, 0, 255, 255, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16],
        ] {
            assert!(!passes(ATT, att), "{att:?}");
        }
        assert!(!passes(SIGNALLING, &[0x13, 1, 2, 0, 0]));
        assert!(!passes(SIGNALLING, &[0x14, 1, 10, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]));
        assert!(!passes(SECURITY, &[0x0C; 64]));
        // Some of these packets come only from a peripheral.
        // The others carry keys that Secure Connections do not distribute.
        for (code, length) in [(0x02, 7), (0x0B, 2), (0x06, 17), (0x07, 11), (0x0A, 17)] {
            assert!(!is_security(code, length), "{code}");
        }
        assert!(!passes(0x40, &[1, 2, 3]));
        assert!(!Guard::default().passes(true, &[3, 0, 4]));
        // The content is longer than the header states, and longer than the board accepts.
        assert!(!Guard::default().passes(true, &[1, 0, 4, 0, 0x1E, 0x1E]));
        assert!(!Guard::default().passes(true, &[248, 0, 4, 0, 0x52]));
    }

    #[test]
    fn a_packet_in_pieces_passes_and_no_more_of_it_than_it_says() {
        let whole = packet(ATT, &[0x52, 12, 0, 1, 2, 3, 4, 5, 6]);
        let mut guard = Guard::default();
        assert!(guard.passes(true, &whole[..6]) && guard.is_waiting());
        assert!(guard.passes(false, &whole[6..9]));
        assert!(!guard.passes(false, &[0; 20]), "too much");
        assert!(guard.passes(false, &whole[9..]) && !guard.is_waiting());
        assert!(!guard.passes(false, &[1]), "nothing has begun");
        // If another packet begins too early, the host stack disconnects.
        // The number of bytes that are missing from the first packet stays the same.
        assert!(guard.passes(true, &whole[..6]));
        assert!(guard.passes(true, &packet(ATT, &[0x0A, 3, 0])) && guard.is_waiting());
        assert!(!guard.passes(true, &packet(ATT, &[0x0A, 3])));
        assert!(!guard.passes(false, &whole[5..]));
        assert!(guard.passes(false, &whole[6..]) && !guard.is_waiting());
        // If the beginning of a packet was rejected, its end must be rejected too.
        assert!(!guard.passes(true, &[9, 0, 4, 0, 0x01]));
        assert!(!guard.passes(false, &[0; 8]));
    }
}
