//! Exchanges two images page by page, so that the power may fail at any word of flash.
//!
//! ```text
//! forth, i = 0, 1 …    A[i] → B[i],      then  B[i + 1] → A[i]
//! back,  i = … 1, 0    A[i] → B[i + 1],  then  B[i] → A[i]
//! ```
//!
//! Each copy goes to a page whose content is also elsewhere, and is repeated from the start after a power cut.
//! A mark in the journal is written after each copy.
//! A mark that was written only in part may count as made or not: the copy before it is complete, and the next one has not begun.

use crate::update::{Progress, Request, read_journal, word};

/// Flash, with offsets in bytes.
pub trait Flash {
    /// Why an operation ends.
    type Error;

    /// Reads a word.
    fn word(&self, at: u32) -> u32;
    /// Writes a word, of which only zeros have an effect.
    ///
    /// # Errors
    /// If the flash does not work.
    fn write(&mut self, at: u32, word: u32) -> Result<(), Self::Error>;
    /// Erases a page and copies another one to it.
    ///
    /// # Errors
    /// If the flash does not work.
    fn copy_page(&mut self, from: u32, to: u32) -> Result<(), Self::Error>;
}

/// Where everything lies in a flash.
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
    /// The layout of a board whose second stage lies at offset 0.
    pub const BOARD: Self = Self {
        a: crate::update::SLOT_A,
        b: crate::update::SLOT_B,
        journal: crate::update::JOURNAL,
        pages: crate::update::IMAGE_MAX / crate::update::PAGE_BYTES,
        page_bytes: crate::update::PAGE_BYTES,
    };
}

// Four marks for each page must fit behind the other words.
const _: () = assert!(4 * (word::FORTH + 4 * Layout::BOARD.pages) <= Layout::BOARD.page_bytes);

/// Decides which image runs, and puts it into slot A. Call this at each start, before the image.
///
/// `accepts` checks the new image in slot B; only an image that it accepts is exchanged.
///
/// # Errors
/// If the flash does not work. The next call continues.
pub fn start<F: Flash>(
    flash: &mut F,
    layout: Layout,
    accepts: impl FnOnce(&F, &Request) -> bool,
) -> Result<(), F::Error> {
    let mut swap = Swap { flash, layout };
    let Some((request, progress)) = read_journal(|at| swap.word(at)) else { return Ok(()) };
    let back = word::FORTH + 2 * layout.pages;
    match progress {
        Progress::Refused | Progress::Confirmed | Progress::WentBack => Ok(()),
        Progress::Waiting => {
            // Until the first mark, both images are complete, so a check can be repeated.
            if swap.word(word::FORTH) == word::BLANK && !accepts(swap.flash, &request) {
                return swap.mark(word::REFUSED);
            }
            swap.exchange(word::FORTH, |i, page| {
                [(layout.a + page(i), layout.b + page(i)), (layout.b + page(i + 1), layout.a + page(i))]
            })?;
            swap.mark(word::TRIED)
        }
        Progress::OnTrial => {
            let last = layout.pages - 1;
            swap.exchange(back, |i, page| {
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

    /// Makes the copies whose marks are missing. `copies` returns the two copies of step `i`, as pairs of source and destination.
    fn exchange(
        &mut self,
        marks: u32,
        copies: impl Fn(u32, &dyn Fn(u32) -> u32) -> [(u32, u32); 2],
    ) -> Result<(), F::Error> {
        let total = 2 * self.layout.pages;
        let done = (0..total).find(|mark| self.word(marks + mark) == word::BLANK).unwrap_or(total);
        if done > 0 {
            // A mark that was interrupted could read differently later, so it is written once more.
            self.mark(marks + done - 1)?;
        }
        let page_bytes = self.layout.page_bytes;
        for mark in done..total {
            let (from, to) = copies(mark / 2, &|page| page * page_bytes)[mark as usize % 2];
            self.flash.copy_page(from, to)?;
            self.mark(marks + mark)?;
        }
        Ok(())
    }
}
