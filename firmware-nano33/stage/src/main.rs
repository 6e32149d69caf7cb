//! The second stage of the boot process: the board's bootloader starts it, and it starts the image.
//! Before that, it finishes an interrupted update, begins a requested update, or undoes a failed update.
//! Updates never change the second stage itself.
//!
//! `shared_board::swap` contains the logic of the exchange.
//! This file controls the chip's flash, checks new images, and starts the image.
#![no_std]
#![no_main]

use cortex_m::peripheral::SCB;
use ed25519_compact::{PublicKey, Signature};
use shared_board::swap::{self, Flash, Layout};
use shared_board::update::{
    END, KEY_AT, KEY_BYTES, NEW_IMAGE, PAGE_BYTES, Request, SIGNATURE_BYTES, SLOT_A, SLOT_B, Source, Trailer,
};
use shared_dsp::right::network::crc32;

unsafe extern "C" {
    /// The default handler of `cortex-m-rt`.
    fn DefaultHandler();
}

/// The table of interrupts. The second stage enables none, so the table needs no entries, but the linker wants one.
#[unsafe(link_section = ".vector_table.interrupts")]
#[unsafe(no_mangle)]
pub static __INTERRUPTS: [unsafe extern "C" fn(); 1] = [DefaultHandler];

unsafe extern "C" {
    #[link_name = "_base"]
    static BASE: u8;
}

/// Returns the start address of the second stage.
fn base() -> u32 {
    (&raw const BASE) as u32
}

/// Returns `len` bytes of flash at an offset from the base, or no bytes if they do not end before [`END`].
fn stored(at: u32, len: usize) -> &'static [u8] {
    let len = if len <= (END - at) as usize { len } else { 0 };
    // SAFETY: this is memory-mapped flash that the linker does not use. No reference exists while `Nvmc` writes.
    unsafe { core::slice::from_raw_parts((base() + at) as *const u8, len) }
}

/// The chip's flash controller, and the watchdog, which may still be running after a restart.
struct Nvmc;

impl Nvmc {
    const READY: *const u32 = 0x4001_E400 as _;
    const CONFIG: *mut u32 = 0x4001_E504 as _;
    const ERASE_PAGE: *mut u32 = 0x4001_E508 as _;
    const WRITE: u32 = 1;
    const ERASE: u32 = 2;
    const WATCHDOG_RELOAD: *mut u32 = 0x4001_0600 as _;
    const RELOAD: u32 = 0x6E52_4635;

    /// Feeds the watchdog. Its time-out is at least two seconds.
    fn feed() {
        for register in 0..8 {
            // SAFETY: these are the eight reload registers of this chip, and they accept writes at any time.
            unsafe { Self::WATCHDOG_RELOAD.add(register).write_volatile(Self::RELOAD) }
        }
    }

    /// Performs an operation while the flash controller is in this mode.
    fn with(mode: u32, act: impl FnOnce()) {
        Self::feed();
        // SAFETY: these are registers of this chip, and no other code runs.
        // A flash operation stops the processor until the operation is complete.
        // The pages that contain this code are never erased.
        unsafe {
            Self::CONFIG.write_volatile(mode);
            act();
            Self::wait();
            Self::CONFIG.write_volatile(0);
        }
    }

    fn wait() {
        // SAFETY: this is a register of this chip, as above.
        while unsafe { Self::READY.read_volatile() } == 0 {}
    }

    fn put(at: u32, word: u32) {
        // SAFETY: `at` is in a slot or the journal, and the controller accepts writes.
        unsafe { ((base() + at) as *mut u32).write_volatile(word) }
        Self::wait();
    }
}

impl Flash for Nvmc {
    type Error = core::convert::Infallible;

    fn word(&self, at: u32) -> u32 {
        // SAFETY: this reads memory-mapped flash.
        unsafe { ((base() + at) as *const u32).read_volatile() }
    }

    fn write(&mut self, at: u32, word: u32) -> Result<(), Self::Error> {
        Self::with(Self::WRITE, || Self::put(at, word));
        Ok(())
    }

    fn copy_page(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        // SAFETY: the page is in a slot, and `with` has enabled erasing.
        Self::with(Self::ERASE, || unsafe { Self::ERASE_PAGE.write_volatile(base() + to) });
        Self::with(Self::WRITE, || {
            for at in (0..PAGE_BYTES).step_by(4) {
                let word = self.word(from + at);
                // Blank words are already correct after the erase, so writing them would waste time.
                if word != u32::MAX {
                    Self::put(to + at, word);
                }
            }
        });
        Ok(())
    }
}

/// Returns whether the image in slot B may run on this board.
fn accepts(_: &Nvmc, request: &Request) -> bool {
    let file = stored(SLOT_B + NEW_IMAGE, request.size as usize);
    Nvmc::feed();
    let fits = crc32(file) == request.crc32
        && Trailer::read(file).is_ok_and(|trailer| trailer.origin == base() + SLOT_A);
    Nvmc::feed();
    fits && (request.source == Source::Cable || is_signed(file))
}

fn is_signed(file: &[u8]) -> bool {
    let Some((signed, signature)) = file.split_at_checked(file.len() - SIGNATURE_BYTES) else { return false };
    let key = stored(KEY_AT, KEY_BYTES);
    let (Ok(key), Ok(signature)) = (PublicKey::from_slice(key), Signature::from_slice(signature)) else {
        return false;
    };
    stored(KEY_AT, KEY_BYTES) != [0xFF; KEY_BYTES] && key.verify(signed, &signature).is_ok()
}

#[cortex_m_rt::entry]
fn main() -> ! {
    // The bootloader may leave interrupts enabled, but this code has no interrupt handlers.
    cortex_m::interrupt::disable();
    let Ok(()) = swap::start(&mut Nvmc, Layout::BOARD, accepts);
    let image = base() + SLOT_A;
    // SAFETY: slot A contains an image, which starts with its vector table.
    // The image starts as after a reset, and registers its own vector table.
    unsafe {
        cortex_m::interrupt::enable();
        cortex_m::asm::bootload(image as *const u32)
    }
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    SCB::sys_reset()
}
