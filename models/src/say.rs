//! What the programs print: like `std`'s macros, but a reader that goes away causes no panic.
//!
//! `… | head`, a closed terminal or a full disk end a command with what it has done, not in the middle of it.
//! Both programs say `#[macro_use] extern crate models;` and write `println!` as everybody does.

use std::fmt::Arguments;
use std::io::{ErrorKind, Write as _};
use std::sync::atomic::{AtomicBool, Ordering};

static LOST: AtomicBool = AtomicBool::new(false);

/// Prints to the standard output; for the macros.
pub fn out(text: Arguments<'_>) {
    let mut out = std::io::stdout().lock();
    if let Err(error) = out.write_fmt(text).and_then(|()| out.flush())
        // The reader that closed the pipe has read enough.
        && error.kind() != ErrorKind::BrokenPipe
        && !LOST.swap(true, Ordering::SeqCst)
    {
        err(format_args!("error: the output cannot be written: {error}\n"));
    }
}

/// Prints to the standard error; for the macros.
pub fn err(text: Arguments<'_>) {
    // Nobody is left to be told.
    let _ = std::io::stderr().lock().write_fmt(text);
}

/// Something printed was lost, other than by a reader that closed the pipe: the command has failed.
pub fn lost() -> bool {
    LOST.load(Ordering::SeqCst)
}

/// Like `std::print`; a failure is remembered, see [`lost`].
#[macro_export]
macro_rules! print {
    ($($part:tt)*) => { $crate::say::out(::core::format_args!($($part)*)) };
}

/// Like `std::println`; a failure is remembered, see [`lost`].
#[macro_export]
macro_rules! println {
    () => { $crate::say::out(::core::format_args!("\n")) };
    ($($part:tt)*) => { $crate::say::out(::core::format_args!("{}\n", ::core::format_args!($($part)*))) };
}

/// Like `std::eprintln`; a failure is ignored.
#[macro_export]
macro_rules! eprintln {
    () => { $crate::say::err(::core::format_args!("\n")) };
    ($($part:tt)*) => { $crate::say::err(::core::format_args!("{}\n", ::core::format_args!($($part)*))) };
}
