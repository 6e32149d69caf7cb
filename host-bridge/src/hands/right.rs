//! To come.
use super::Board;

/// x
pub struct RightBoard;
/// x
pub struct ModelFile;
/// x
pub struct ModelFileError;
impl Board for RightBoard {
    fn step(&mut self, _: u64, _: &mut Vec<u8>) {}
    fn receive(&mut self, _: &[u8], _: &mut Vec<u8>) {}
    fn laptop_time_ms(&self, board_time_ms: u32) -> u64 {
        board_time_ms.into()
    }
    fn ended(&self) -> bool {
        true
    }
}
