//! What turns a table of messages into enums, numbers and sizes.

use crate::frame::frame_len;
use postcard::experimental::max_size::MaxSize;
use serde::Serialize;

/// Which boards send a message, or take it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Boards {
    /// The left one alone.
    Left,
    /// The right one alone.
    Right,
    /// Both.
    Both,
}

impl Boards {
    /// As `WIRE.md` names them.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
            Self::Both => "both",
        }
    }
}

/// What a table says of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row {
    /// Its number on the wire.
    pub number: u8,
    /// Its name.
    pub name: &'static str,
    /// Who sends it or takes it.
    pub boards: Boards,
    /// The minor version of the wire that added it.
    pub since: u8,
    /// Its largest frame, in bytes.
    pub frame_max: usize,
}

/// The largest frame of a table, in bytes; only of what the left board sends or takes, or of all.
pub(crate) const fn largest(rows: &[Row], left_only: bool) -> usize {
    let (mut most, mut i) = (0, 0);
    while i < rows.len() {
        let counts = !left_only || !matches!(rows[i].boards, Boards::Right);
        if counts && rows[i].frame_max > most {
            most = rows[i].frame_max;
        }
        i += 1;
    }
    most
}

/// Rows stand in the order of their numbers, and none is newer than the version.
pub(crate) const fn is_sound(rows: &[Row], minor: u8) -> bool {
    let mut i = 0;
    while i < rows.len() {
        // A number is one byte on the wire, as long as there are fewer than 128.
        if rows[i].number as usize != i || i >= 128 || rows[i].since > minor {
            return false;
        }
        i += 1;
    }
    true
}

/// What a [`BoardMessage`](super::BoardMessage) contains.
pub trait BoardBody: Serialize + MaxSize {
    /// The message's number on the wire.
    const NUMBER: u8;
    /// Its largest frame, in bytes.
    const FRAME_MAX: usize = frame_len(1 + Self::POSTCARD_MAX_SIZE);
}

/// A list that may grow in a minor version: one byte on the wire, and an older reader keeps a value
/// it does not know as `Unknown` instead of losing the whole message.
macro_rules! open_list {
    ($(#[$doc:meta])* $name:ident { $($(#[$value_doc:meta])* $value:ident = $byte:literal,)* }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(from = "u8", into = "u8")]
        pub enum $name {
            $($(#[$value_doc])* $value,)*
            /// A value that a later minor version added.
            Unknown(u8),
        }

        impl MaxSize for $name {
            const POSTCARD_MAX_SIZE: usize = 1;
        }

        impl From<u8> for $name {
            fn from(byte: u8) -> Self {
                match byte {
                    $($byte => Self::$value,)*
                    other => Self::Unknown(other),
                }
            }
        }

        impl From<$name> for u8 {
            fn from(value: $name) -> Self {
                match value {
                    $($name::$value => $byte,)*
                    $name::Unknown(other) => other,
                }
            }
        }
    };
}

/// The enum of a table and its rows.
macro_rules! messages {
    ($(#[$doc:meta])* $message:ident<$a:lifetime> { $(
        $(#[$meta:meta])* $number:literal $name:ident
        $(($body:ty))? $({ $($(#[$field_meta:meta])* $field:ident: $type:ty,)* })?
        => $boards:ident, $since:literal;
    )* }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
        pub enum $message<$a> { $(
            $(#[$meta])*
            #[doc = concat!("\n\nNumber ", $number, ", since minor version ", $since, ". Boards: ", stringify!($boards), ".")]
            $name $(($body))? $({ $($(#[$field_meta])* $field: $type,)* })?,
        )* }

        impl<$a> $message<$a> {
            /// The table, by number.
            pub const ROWS: &'static [Row] = &[$(Row {
                number: $number,
                name: stringify!($name),
                boards: Boards::$boards,
                since: $since,
                frame_max: frame_len(
                    1 $(+ <$body as MaxSize>::POSTCARD_MAX_SIZE)? $($(+ <$type as MaxSize>::POSTCARD_MAX_SIZE)*)?
                ),
            },)*];

            /// What the table says of this message.
            pub const fn row(&self) -> &'static Row {
                match self {
                    $(Self::$name { .. } => &Self::ROWS[$number],)*
                }
            }
        }

        const _: () = assert!(table::is_sound($message::ROWS, PROTOCOL_MINOR), "numbers or versions are out of order");
    };
}

/// What boards send: each message is a body with a type of its own.
macro_rules! board_messages {
    ($(#[$doc:meta])* $message:ident<$a:lifetime> { $(
        $(#[$meta:meta])* $number:literal $name:ident($body:ty) => $boards:ident, $since:literal;
    )* }) => {
        messages! { $(#[$doc])* $message<$a> { $(
            $(#[$meta])* $number $name($body) => $boards, $since;
        )* } }

        $(impl<$a> BoardBody for $body {
            const NUMBER: u8 = $number;
        })*
    };
}

/// What boards take. The left one has no room for the code that reads all of it: its part is an enum of its own.
macro_rules! host_messages {
    ($($table:tt)*) => {
        messages! { $($table)* }
        left_requests! { $($table)* }
    };
}

/// Keeps all rows but those of `Right`, one after the other, and makes the enum of what is kept.
macro_rules! left_requests {
    ($(#[$doc:meta])* $message:ident<$a:lifetime> { $($rows:tt)* }) => {
        left_requests! { keep $message {} $($rows)* }
    };
    (keep $message:ident { $($kept:tt)* }
        $(#[$meta:meta])* $number:literal $name:ident $(($($body:tt)*))? $({ $($fields:tt)* })?
        => Right, $since:literal; $($rest:tt)*
    ) => {
        left_requests! { keep $message { $($kept)* } $($rest)* }
    };
    (keep $message:ident { $($kept:tt)* }
        $(#[$meta:meta])* $number:literal $name:ident $({ $($fields:tt)* })?
        => $boards:ident, $since:literal; $($rest:tt)*
    ) => {
        left_requests! { keep $message { $($kept)* $number $name $({ $($fields)* })?; } $($rest)* }
    };
    (keep $message:ident { $(
        $number:literal $name:ident $({ $($(#[$field_meta:meta])* $field:ident: $type:ty,)* })?;
    )* }) => {
        #[doc = concat!("The part of [`", stringify!($message), "`] that a left board takes: same numbers, same fields.")]
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum LeftRequest { $(
            #[doc = concat!("See [`", stringify!($message), "::", stringify!($name), "`].")]
            $name $({ $($(#[$field_meta])* $field: $type,)* })?,
        )* }

        impl LeftRequest {
            /// Reads one from the front of a payload, and returns the bytes behind it.
            pub(crate) fn take(payload: &[u8]) -> Result<(Self, &[u8]), ParseError> {
                let (number, rest) = payload.split_first().ok_or(ParseError::Malformed)?;
                match *number {
                    $($number => {
                        $($(let ($field, rest) = table::take::<$type>(rest)?;)*)?
                        Ok((Self::$name $({ $($field),* })?, rest))
                    })*
                    _ => Err(ParseError::Unknown),
                }
            }
        }
    };
}

/// Reads one field from the front of a payload.
pub(crate) fn take<T: serde::de::DeserializeOwned>(
    bytes: &[u8],
) -> Result<(T, &[u8]), crate::frame::ParseError> {
    postcard::take_from_bytes(bytes).map_err(|_| crate::frame::ParseError::Malformed)
}
