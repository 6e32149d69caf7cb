//! Texts and bytes whose maximum length is part of their type, so that the compiler knows the largest message.

use core::fmt;
use core::ops::Deref;
use postcard::experimental::max_size::MaxSize;
use serde::{Deserialize, Serialize};

/// Size on the wire of this number of bytes, with their length. All lengths in our messages are below 2^14.
const fn with_length(max: usize) -> usize {
    assert!(max < 1 << 14);
    if max < 128 { 1 + max } else { 2 + max }
}

/// A text of at most `MAX` bytes of UTF-8. Encoding a longer text may fail.
#[derive(Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Text<'a, const MAX: usize>(pub &'a str);

/// A list of at most `MAX` bytes. Encoding a longer list may fail.
#[derive(Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Bytes<'a, const MAX: usize>(pub &'a [u8]);

impl<const MAX: usize> MaxSize for Text<'_, MAX> {
    const POSTCARD_MAX_SIZE: usize = with_length(MAX);
}

impl<const MAX: usize> MaxSize for Bytes<'_, MAX> {
    const POSTCARD_MAX_SIZE: usize = with_length(MAX);
}

impl<const MAX: usize> Deref for Text<'_, MAX> {
    type Target = str;

    fn deref(&self) -> &str {
        self.0
    }
}

impl<const MAX: usize> Deref for Bytes<'_, MAX> {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        self.0
    }
}

impl<const MAX: usize> fmt::Debug for Text<'_, MAX> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl<const MAX: usize> fmt::Debug for Bytes<'_, MAX> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}
