//! Checks whether a board and this program have compatible versions, and proposes a remedy.

use crate::message::{Board, Hello, PROTOCOL_MAJOR, PROTOCOL_MINOR};
use core::fmt;

/// How a board's minor version relates to ours. All three cases are compatible.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Compatibility {
    /// The versions are equal.
    Same,
    /// The board does not know some messages that we know.
    /// Requests may be answered with [`Unsupported`](crate::message::AckResult::Unsupported), or not at all.
    BoardOlder,
    /// The board may send messages that we do not know. They are only counted.
    BoardNewer,
}

/// The board has another major version, so only its hello can be read.
///
/// The text of this error explains which side to update, and how.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mismatch {
    /// The board.
    pub board: Board,
    /// The board's major version.
    pub major: u8,
    /// The board's minor version.
    pub minor: u8,
}

/// Compares a board's version with ours.
///
/// # Errors
/// Returns a [`Mismatch`] if the major versions differ. Accept no other message from such a board.
/// Send only [`HelloRequest`](crate::message::HostMessage::HelloRequest) to such a board.
pub fn check(hello: &Hello<'_>) -> Result<Compatibility, Mismatch> {
    if hello.major != PROTOCOL_MAJOR {
        return Err(Mismatch { board: hello.board, major: hello.major, minor: hello.minor });
    }
    Ok(match hello.minor.cmp(&PROTOCOL_MINOR) {
        core::cmp::Ordering::Equal => Compatibility::Same,
        core::cmp::Ordering::Less => Compatibility::BoardOlder,
        core::cmp::Ordering::Greater => Compatibility::BoardNewer,
    })
}

impl fmt::Display for Mismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { board, major, minor } = self;
        write!(
            f,
            "{board} speaks protocol {major}.{minor}, host-bridge {PROTOCOL_MAJOR}.{PROTOCOL_MINOR}: "
        )?;
        if *major > PROTOCOL_MAJOR {
            return f.write_str("update host-bridge (fetch the newest source, then `cargo build --release`)");
        }
        f.write_str("update the board (plug it in, then `cargo run --release` in ")?;
        f.write_str(board.folder().unwrap_or("the folder of its firmware"))?;
        f.write_str(")")
    }
}

impl core::error::Error for Mismatch {}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::message::Text;
    use std::string::ToString;

    fn hello(board: Board, major: u8, minor: u8) -> Hello<'static> {
        Hello { major, minor, board, firmware: Text("0.1.0"), boot_id: 1, model_id: 0, sample_hz: 100 }
    }

    #[test]
    fn minor_versions_work_together() {
        let check = |minor| check(&hello(Board::LeftNano, PROTOCOL_MAJOR, minor));
        assert_eq!(check(PROTOCOL_MINOR), Ok(Compatibility::Same));
        assert_eq!(check(PROTOCOL_MINOR + 1), Ok(Compatibility::BoardNewer));
        if let Some(older) = PROTOCOL_MINOR.checked_sub(1) {
            assert_eq!(check(older), Ok(Compatibility::BoardOlder));
        }
    }

    #[test]
    fn a_mismatch_names_the_side_to_update_and_how() {
        let text = |board, major| check(&hello(board, major, 3)).unwrap_err().to_string();
        let older = text(Board::LeftNano, PROTOCOL_MAJOR - 1);
        assert!(older.contains("update the board") && older.contains("firmware-nano-avr/"), "{older}");
        let older = text(Board::RightNano33, PROTOCOL_MAJOR - 1);
        assert!(older.contains("update the board") && older.contains("firmware-nano33/"), "{older}");
        let newer = text(Board::RightNano33, PROTOCOL_MAJOR + 1);
        assert!(newer.contains("update host-bridge") && !newer.contains("update the board"), "{newer}");
        let unknown = text(Board::Unknown(77), PROTOCOL_MAJOR + 1);
        assert!(unknown.contains("unknown kind 77") && unknown.contains("update host-bridge"), "{unknown}");
    }
}
