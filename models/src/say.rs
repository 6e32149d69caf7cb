//! Prints the output of the programs. The macros work like those of `std`, but do not panic if the reader disappears.
//!
//! After `… | head`, a closed terminal or a full disk, a command still finishes its work.
//! Both programs use `#[macro_use] extern crate models;` and then the normal `println!`.

use std::fmt::Arguments;
use std::io::{ErrorKind, Write as _};
use std::sync::atomic::{AtomicBool, Ordering};

static LOST: AtomicBool = AtomicBool::new(false);

/// Prints to standard output for the macros.
pub fn out(text: Arguments<'_>) {
    let mut out = std::io::stdout().lock();
    if let Err(error) = out.write_fmt(text).and_then(|()| out.flush())
        // A reader that closed the pipe needs no further output.
        && error.kind() != ErrorKind::BrokenPipe
        && !LOST.swap(true, Ordering::SeqCst)
    {
        err(format_args!("error: the output cannot be written: {error}\n"));
    }
}

/// Prints to standard error for the macros.
pub fn err(text: Arguments<'_>) {
    // Nobody reads the output any more, so nobody can be notified.
    let _ = std::io::stderr().lock().write_fmt(text);
}

/// Returns whether output was lost for a reason other than a closed pipe. The command has then failed.
pub fn lost() -> bool {
    LOST.load(Ordering::SeqCst)
}

/// Like `std::print`, but failures are recorded (see [`lost`]).
#[macro_export]
macro_rules! print {
    ($($part:tt)*) => { $crate::say::out(::core::format_args!($($part)*)) };
}

/// Like `std::println`, but failures are recorded (see [`lost`]).
#[macro_export]
macro_rules! println {
    () => { $crate::say::out(::core::format_args!("\n")) };
    ($($part:tt)*) => { $crate::say::out(::core::format_args!("{}\n", ::core::format_args!($($part)*))) };
}

/// Like `std::eprintln`, but failures are ignored.
#[macro_export]
macro_rules! eprintln {
    () => { $crate::say::err(::core::format_args!("\n")) };
    ($($part:tt)*) => { $crate::say::err(::core::format_args!("{}\n", ::core::format_args!($($part)*))) };
}
