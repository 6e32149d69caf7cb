//! Exchanges two images page by page, and survives a power cut at any word of flash.
//!
//! ```text
//! forth, i = 0, 1 …    A[i] → B[i],      then  B[i + 1] → A[i]
//! back,  i = … 1, 0    A[i] → B[i + 1],  then  B[i] → A[i]
//! ```
//!
//! Each copy overwrites only a page whose content also exists elsewhere.
//! After a power cut, the interrupted copy is repeated from its start.
//! After each copy, a mark is written in the journal.
//! A partly written mark is harmless, whether it reads as made or not:
//! the copy before the mark is complete, and the next copy has not begun.

use crate::update::{Progress, Request, read_journal, word};

/// Flash, with offsets in bytes.
pub trait Flash {
    /// The reason why an operation failed.
    type Error;

    /// Reads a word.
    fn word(&self, at: u32) -> u32;
    /// Writes a word. A write can only clear bits, so the ones in `word` have no effect.
    ///
    /// # Errors
    /// Fails if the flash does not work.
    fn write(&mut self, at: u32, word: u32) -> Result<(), Self::Error>;
    /// Erases the page at `to`, and copies the page at `from` to it.
    ///
    /// # Errors
    /// Fails if the flash does not work.
    fn copy_page(&mut self, from: u32, to: u32) -> Result<(), Self::Error>;
}

/// The offsets and sizes of the areas in a flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Start of slot A.
    pub a: u32,
    /// Start of slot B, which has one page more than slot A.
    pub b: u32,
    /// Start of the journal, which is one page.
    pub journal: u32,
    /// Number of pages of slot A.
    pub pages: u32,
    /// Bytes per page.
    pub page_bytes: u32,
}

impl Layout {
    /// The layout of a board, with offsets from the start of the second stage.
    pub const BOARD: Self = Self {
        a: crate::update::SLOT_A,
        b: crate::update::SLOT_B,
        journal: crate::update::JOURNAL,
        pages: crate::update::IMAGE_MAX / crate::update::PAGE_BYTES,
        page_bytes: crate::update::PAGE_BYTES,
    };
}

// The journal needs room for four marks per page after its other words.
const _: () = assert!(4 * (word::FORTH + 4 * Layout::BOARD.pages) <= Layout::BOARD.page_bytes);

/// Decides which image runs, and puts this image into slot A.
/// Call this function at each start of the board, before the image starts.
///
/// `accepts` checks the new image in slot B. An image that fails this check is not installed.
///
/// # Errors
/// Fails if the flash does not work. The next call then continues the exchange.
pub fn start<F: Flash>(
    flash: &mut F,
    layout: Layout,
    accepts: impl FnOnce(&F, &Request) -> bool,
) -> Result<(), F::Error> {
    let mut swap = Swap { flash, layout };
    let Some((request, progress)) = read_journal(|at| swap.word(at)) else { return Ok(()) };
    let back = word::FORTH + 2 * layout.pages;
    let page = |i: u32| i * layout.page_bytes;
    match progress {
        Progress::Refused | Progress::Confirmed | Progress::WentBack => Ok(()),
        Progress::Waiting => {
            // Until the first mark is made, both images are complete, so the check can be repeated.
            if swap.word(word::FORTH) == word::BLANK && !accepts(swap.flash, &request) {
                return swap.mark(word::REFUSED);
            }
            swap.exchange(word::FORTH, |i| {
                [(layout.a + page(i), layout.b + page(i)), (layout.b + page(i + 1), layout.a + page(i))]
            })?;
            swap.mark(word::TRIED)
        }
        Progress::OnTrial => {
            let last = layout.pages - 1;
            swap.exchange(back, |i| {
                let i = last - i;
                [(layout.a + page(i), layout.b + page(i + 1)), (layout.b + page(i), layout.a + page(i))]
            })?;
            swap.mark(word::WENT_BACK)
        }
    }
}

struct Swap<'f, F> {
    flash: &'f mut F,
    layout: Layout,
}

impl<F: Flash> Swap<'_, F> {
    fn word(&self, number: u32) -> u32 {
        self.flash.word(self.layout.journal + 4 * number)
    }

    fn mark(&mut self, number: u32) -> Result<(), F::Error> {
        self.flash.write(self.layout.journal + 4 * number, 0)
    }

    /// Makes all copies whose marks are missing.
    /// `copies` returns the two copies of step `i`, each as a source and a destination.
    fn exchange(&mut self, marks: u32, copies: impl Fn(u32) -> [(u32, u32); 2]) -> Result<(), F::Error> {
        let total = 2 * self.layout.pages;
        let done = (0..total).find(|mark| self.word(marks + mark) == word::BLANK).unwrap_or(total);
        if done > 0 {
            // An interrupted write can leave a mark that reads differently later, so the last mark is written again.
            self.mark(marks + done - 1)?;
        }
        for mark in done..total {
            let (from, to) = copies(mark / 2)[mark as usize % 2];
            self.flash.copy_page(from, to)?;
            self.mark(marks + mark)?;
        }
        Ok(())
    }
}
