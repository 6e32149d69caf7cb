//! What the board shows of a pairing: the passkey while a laptop asks for it, and how the present link was paired.

use core::sync::atomic::{AtomicU32, Ordering};

/// How the present link was paired.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pairing {
    /// Nobody compared or typed a number.
    JustWorks,
    /// The owner typed the passkey at the laptop.
    PasskeyTyped,
}

/// Every passkey is below these values.
const NONE: u32 = u32::MAX;
const JUST_WORKS: u32 = NONE - 1;
const PASSKEY_TYPED: u32 = NONE - 2;

static NOW: AtomicU32 = AtomicU32::new(NONE);

/// Returns the passkey that the owner must type now, if any.
pub fn passkey() -> Option<u32> {
    Some(NOW.load(Ordering::Relaxed)).filter(|&now| now < PASSKEY_TYPED)
}

/// Returns how the present link was paired, once it is encrypted.
pub fn paired() -> Option<Pairing> {
    match NOW.load(Ordering::Relaxed) {
        JUST_WORKS => Some(Pairing::JustWorks),
        PASSKEY_TYPED => Some(Pairing::PasskeyTyped),
        _ => None,
    }
}

/// Shows this passkey.
pub(super) fn show(passkey: u32) {
    NOW.store(passkey, Ordering::Relaxed);
}

/// Shows no passkey, because the pairing or the link has ended.
pub(super) fn clear() {
    NOW.store(NONE, Ordering::Relaxed);
}

/// The link is encrypted with the keys of such a pairing.
pub(super) fn set_paired(with_passkey: bool) {
    NOW.store(if with_passkey { PASSKEY_TYPED } else { JUST_WORKS }, Ordering::Relaxed);
}
