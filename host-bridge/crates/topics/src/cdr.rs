//! Little-endian CDR as in ROS 2: four bytes of header, followed by the fields.
//! This module uses the crate `cdr-encoding`, like the ROS 2 client.

use byteorder::LittleEndian;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Marks CDR, little endian.
const HEADER: [u8; 4] = [0, 1, 0, 0];

/// Encodes a message, which may contain only numbers, texts, sequences, arrays and structures.
pub fn encode(message: &impl Serialize) -> Vec<u8> {
    let mut bytes = HEADER.to_vec();
    // Writing to a `Vec` cannot fail. Padding is counted from the end of the header.
    let _ = cdr_encoding::to_writer::<_, LittleEndian, _>(&mut bytes, message);
    bytes
}

/// Decodes a message. Returns `None` if its header differs or it is too short.
pub fn decode<T: DeserializeOwned>(message: &[u8]) -> Option<T> {
    let body = message.strip_prefix(&HEADER)?;
    Some(cdr_encoding::from_bytes::<T, LittleEndian>(body).ok()?.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_aligned_behind_the_header_and_texts_end_in_zero() {
        let message = encode(&(7_u8, 1_u32, "ab", 1.5_f64, [-1_i16, 2], vec![(true, vec![9_u8, 8])]));
        let mut expected = vec![0, 1, 0, 0, 7, 0, 0, 0, 1, 0, 0, 0, 3, 0, 0, 0, b'a', b'b', 0];
        // 15 bytes follow the header, including one byte of padding before the double.
        expected.push(0);
        expected.extend(1.5_f64.to_le_bytes());
        // An array has no length field, but a sequence does.
        expected.extend([255, 255, 2, 0, 1, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 9, 8]);
        assert_eq!(message, expected);
    }

    #[test]
    fn what_is_cut_short_or_of_another_kind_is_none() {
        let message = encode(&(1_u8, 5_u64, vec![b'x', b'y', b'z']));
        let read = decode::<(u8, u64, Vec<u8>)>;
        assert_eq!(read(&message), Some((1, 5, b"xyz".to_vec())));
        for length in 0..message.len() {
            assert_eq!(read(&message[..length]), None);
        }
        let mut other = message.clone();
        other[1] = 0;
        assert_eq!(read(&other), None);
        // If a sequence claims to be longer than any memory, only the message is read.
        assert_eq!(decode::<Vec<u64>>(&[0, 1, 0, 0, 255, 255, 255, 255]), None);
    }
}
