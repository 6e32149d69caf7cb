//! Update files for images that the tests install.

use shared_board::update::Trailer;
use shared_proto::message::Board;

use super::image::Image;

/// The version of the images that were built.
pub const OLD: &str = "0.1.0";
/// Another version of equal length, so that two images differ only in these texts.
pub const NEW: &str = "0.1.9";

/// Creates the update file of an image for this board, and replaces the version in the image by this version.
///
/// # Panics
/// Panics if the image does not contain its version.
pub fn update_file(image: &Image, board: Board, version: &str) -> Vec<u8> {
    let mut bytes = image.binary();
    let places: Vec<usize> =
        (0..bytes.len() - OLD.len()).filter(|&at| bytes[at..].starts_with(OLD.as_bytes())).collect();
    assert!(!places.is_empty(), "the image says its version");
    for at in places {
        bytes[at..at + OLD.len()].copy_from_slice(version.as_bytes());
    }
    let mut text = [0; 16];
    text[..version.len()].copy_from_slice(version.as_bytes());
    Trailer { origin: image.vector_table, board: board.into(), version: text }.file(&bytes)
}
