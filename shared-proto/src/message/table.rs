//! Macros that generate enums, numbers and sizes from a table of messages.

use crate::frame::frame_len;
use postcard::experimental::max_size::MaxSize;
use serde::Serialize;

/// The boards that send or receive a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Boards {
    /// Only the left board.
    Left,
    /// Only the right board.
    Right,
    /// Both boards.
    Both,
}

impl Boards {
    /// Returns the name used in `WIRE.md`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
            Self::Both => "both",
        }
    }
}

/// The row that a message has in its table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row {
    /// The number of the message on the wire.
    pub number: u8,
    /// Its name.
    pub name: &'static str,
    /// The boards that send or receive the message.
    pub boards: Boards,
    /// The minor version of the wire protocol that added the message.
    pub since: u8,
    /// The largest frame of the message in bytes.
    pub frame_max: usize,
}

/// Returns the largest frame of a table in bytes, for all boards or only for the left board.
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

/// Returns whether the rows are in the order of their numbers and no row is newer than the version.
pub(crate) const fn is_sound(rows: &[Row], minor: u8) -> bool {
    let mut i = 0;
    while i < rows.len() {
        // A number is one byte on the wire, because there are fewer than 128.
        if rows[i].number as usize != i || i >= 128 || rows[i].since > minor {
            return false;
        }
        i += 1;
    }
    true
}

/// The body of a [`BoardMessage`](super::BoardMessage).
pub trait BoardBody: Serialize + MaxSize {
    /// The number of the message on the wire.
    const NUMBER: u8;
    /// The largest frame of the message in bytes.
    const FRAME_MAX: usize = frame_len(1 + Self::POSTCARD_MAX_SIZE);
}

/// A list that minor versions may extend. A value takes one byte on the wire.
/// An older reader reads an unknown value as `Unknown` instead of rejecting the message.
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

/// Generates the enum and the rows of a table.
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
            /// All rows in the order of their numbers.
            pub const ROWS: &'static [Row] = &[$(Row {
                number: $number,
                name: stringify!($name),
                boards: Boards::$boards,
                since: $since,
                frame_max: frame_len(
                    1 $(+ <$body as MaxSize>::POSTCARD_MAX_SIZE)? $($(+ <$type as MaxSize>::POSTCARD_MAX_SIZE)*)?
                ),
            },)*];

            /// Returns the row of this message.
            pub const fn row(&self) -> &'static Row {
                match self {
                    $(Self::$name { .. } => &Self::ROWS[$number],)*
                }
            }
        }

        const _: () = assert!($crate::message::table::is_sound($message::ROWS, PROTOCOL_MINOR), "numbers or versions are out of order");
    };
}

/// Messages from boards. The body of each message has its own type.
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

/// Messages to boards. The left board has no room for the code of all messages, so its messages form a separate enum.
macro_rules! host_messages {
    ($($table:tt)*) => {
        messages! { $($table)* }
        left_requests! { $($table)* }
    };
}

/// Removes all rows of `Right` and generates the enum of the remaining rows.
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
            /// Parses a value from the front of a payload, and returns the remaining bytes.
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

/// Parses one field from the front of a payload.
pub(crate) fn take<T: serde::de::DeserializeOwned>(
    bytes: &[u8],
) -> Result<(T, &[u8]), crate::frame::ParseError> {
    postcard::take_from_bytes(bytes).map_err(|_| crate::frame::ParseError::Malformed)
}

/// Checks the statement in docs/ADDING.md that a new message needs only a row.
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
        /// Messages from boards in this test.
        Said<'a> {
            /// The temperature of the board.
            0 Warmth(Warmth) => Both, 0;
            /// A sound.
            #[serde(borrow)]
            1 Noise(Bytes<'a, 4>) => Right, 1;
        }
    }

    host_messages! {
        /// Messages to boards in this test.
        Told<'a> {
            /// A message for both boards.
            0 Hush => Both, 0;
            /// A message that only the right board knows.
            #[serde(borrow)]
            1 Sing(Bytes<'a, 200>) => Right, 0;
            /// Another message for both boards. It follows the message for the right board.
            2 Feel {
                /// The signal to play.
                signal: Signal,
                /// The duration.
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
        // Number, checksum, code byte and delimiter take 7 bytes.
        // The first message has another 2 + 200 bytes, and the second has another 1 + 5 bytes.
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
