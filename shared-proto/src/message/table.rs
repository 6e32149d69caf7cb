//! Macros that turn a table of messages into enums, numbers and sizes.

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

/// The row of a message in its table.
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

            /// The row of this message.
            pub const fn row(&self) -> &'static Row {
                match self {
                    $(Self::$name { .. } => &Self::ROWS[$number],)*
                }
            }
        }

        const _: () = assert!($crate::message::table::is_sound($message::ROWS, PROTOCOL_MINOR), "numbers or versions are out of order");
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
                        $($(let ($field, rest) = $crate::message::table::take::<$type>(rest)?;)*)?
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

/// What docs/ADDING.md says: a message is a row, and all else follows.
#[cfg(test)]
mod tests {
    use super::{BoardBody, Boards, Row};
    use crate::frame::{ParseError, frame_len};
    use crate::message::{Bytes, PROTOCOL_MINOR, Signal};
    use postcard::experimental::max_size::MaxSize;
    use serde::{Deserialize, Serialize};

    #[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, MaxSize)]
    pub struct Warmth {
        celsius: i16,
    }

    board_messages! {
        /// What boards say here.
        Said<'a> {
            /// How warm it is.
            0 Warmth(Warmth) => Both, 0;
            /// A noise.
            #[serde(borrow)]
            1 Noise(Bytes<'a, 4>) => Right, 1;
        }
    }

    host_messages! {
        /// What they are told.
        Told<'a> {
            /// Both take it.
            0 Hush => Both, 0;
            /// Only the right one takes it.
            #[serde(borrow)]
            1 Sing(Bytes<'a, 200>) => Right, 0;
            /// And one after it that both take.
            2 Feel {
                /// What.
                signal: Signal,
                /// How long.
                time_ms: u32,
            } => Both, 3;
        }
    }

    #[test]
    fn a_row_gives_number_size_and_place_in_the_enum() {
        assert_eq!((Warmth::NUMBER, <Bytes<'_, 4> as BoardBody>::NUMBER), (0, 1));
        assert_eq!(Warmth::FRAME_MAX, Said::ROWS[0].frame_max);
        assert_eq!(Said::Warmth(Warmth { celsius: -3 }).row(), &Said::ROWS[0]);
        assert_eq!(Said::Noise(Bytes(&[7])).row().boards, Boards::Right);
        let hush = Row { number: 0, name: "Hush", boards: Boards::Both, since: 0, frame_max: 7 };
        assert_eq!(Told::ROWS[0], hush);
        // Number, checksum, code byte and delimiter around 2 and 200 bytes; number and field around 1 and 5.
        assert_eq!([Told::ROWS[1].frame_max, Told::ROWS[2].frame_max], [209, 13]);
        let feel = Told::Feel { signal: Signal::Stopped, time_ms: 300 };
        assert_eq!((feel.row().name, feel.row().since), ("Feel", 3));
        assert_eq!(postcard::to_slice(&feel, &mut [0; 8]).unwrap(), [2, 3, 0xAC, 2]);
    }

    #[test]
    fn a_left_board_takes_what_is_for_both_under_the_same_number_and_knows_nothing_else() {
        let feel = LeftRequest::Feel { signal: Signal::Stopped, time_ms: 300 };
        assert_eq!(LeftRequest::take(&[2, 3, 0xAC, 2, 9]), Ok((feel, &[9][..])));
        assert_eq!(LeftRequest::take(&[0]), Ok((LeftRequest::Hush, &[][..])));
        assert_eq!(LeftRequest::take(&[1, 0]), Err(ParseError::Unknown));
        assert_eq!(LeftRequest::take(&[3]), Err(ParseError::Unknown));
        assert_eq!(LeftRequest::take(&[2, 3]), Err(ParseError::Malformed));
        assert_eq!(LeftRequest::take(&[]), Err(ParseError::Malformed));
    }

    #[test]
    fn rows_out_of_order_or_newer_than_the_wire_are_refused() {
        let row = |number, since| Row { number, since, ..Told::ROWS[0] };
        assert!(super::is_sound(&[row(0, 0), row(1, 3)], 3));
        for rows in [[row(0, 0), row(2, 0)], [row(1, 0), row(0, 0)], [row(0, 0), row(1, 4)]] {
            assert!(!super::is_sound(&rows, 3), "{rows:?}");
        }
    }
}
