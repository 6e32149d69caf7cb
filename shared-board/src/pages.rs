//! Two pages of flash of which the newer one counts. The next generation goes to the other page, so a power cut loses nothing.
//!
//! ```text
//! page + 0   magic, sequence number, its complement, one word left blank
//! page + 16  contents
//! ```

use crate::models::MappedFlash;
use crate::slots::is_newer;

/// Number of pages.
pub(crate) const PAGES: usize = 2;
/// Number of bytes in a page before its contents.
pub(crate) const HEADER_BYTES: usize = 16;

/// Flash controllers write only complete words.
#[repr(align(4))]
pub(crate) struct Aligned<const N: usize>(pub(crate) [u8; N]);

/// Returns the newest complete page, and where it begins.
pub(crate) fn newest(store: &[u8], page_bytes: usize, magic: u32) -> Option<(usize, &[u8])> {
    let mut best: Option<(usize, &[u8], u32)> = None;
    for (i, page) in store.chunks_exact(page_bytes).take(PAGES).enumerate() {
        let (Some(first), Some(sequence), Some(complement)) = (word(page, 0), word(page, 4), word(page, 8))
        else {
            continue;
        };
        let is_complete = first == magic && sequence == !complement;
        if is_complete && best.is_none_or(|(.., best)| is_newer(sequence, best)) {
            best = Some((i * page_bytes, page, sequence));
        }
    }
    best.map(|(start, page, _)| (start, page))
}

/// Erases the page that is not the newest. Returns where it begins, and the sequence number for it.
pub(crate) async fn erase_next<F: MappedFlash>(flash: &mut F, magic: u32) -> Result<(usize, u32), F::Error> {
    let page = F::ERASE_SIZE;
    let (start, sequence) = match newest(flash.mapped(), page, magic) {
        Some((start, bytes)) => {
            (if start == 0 { page } else { 0 }, word(bytes, 4).unwrap_or(0).wrapping_add(1))
        }
        None => (0, 1),
    };
    flash.erase(start as u32, (start + page) as u32).await?;
    Ok((start, sequence))
}

/// Makes a page whose contents are complete the newest.
pub(crate) async fn finish<F: MappedFlash>(
    flash: &mut F,
    start: usize,
    sequence: u32,
    magic: u32,
) -> Result<(), F::Error> {
    let mut numbers = Aligned([0; 8]);
    numbers.0[..4].copy_from_slice(&sequence.to_le_bytes());
    numbers.0[4..].copy_from_slice(&(!sequence).to_le_bytes());
    flash.write(start as u32 + 4, &numbers.0).await?;
    // Once this word is written, the page is valid.
    flash.write(start as u32, &Aligned(magic.to_le_bytes()).0).await
}

/// Returns the word at this offset.
pub(crate) fn word(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}
