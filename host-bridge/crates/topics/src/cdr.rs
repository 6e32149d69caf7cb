//! CDR, little endian, as ROS 2 writes its messages: four bytes of header, then the fields in turn, each
//! aligned to its size as counted from behind the header.
//!
//! [`encode`] takes whatever serde can show that CDR knows: numbers, texts, sequences, arrays and structures.
//! The messages' types are thereby those that go over DDS, too ([`crate::message`]).

use std::fmt;

use serde::Serialize;
use serde::ser::{Impossible, SerializeSeq, SerializeStruct, SerializeTuple, Serializer};

/// Marks CDR, little endian.
const HEADER: [u8; 4] = [0, 1, 0, 0];

/// One message.
///
/// # Errors
/// It has something that ROS 2 messages have not: options, maps, enumerations with values.
pub fn encode(message: &impl Serialize) -> Result<Vec<u8>, fmt::Error> {
    let mut writer = Writer { bytes: HEADER.to_vec() };
    message.serialize(&mut writer)?;
    Ok(writer.bytes)
}

struct Writer {
    bytes: Vec<u8>,
}

type Done = Result<(), fmt::Error>;

impl Writer {
    fn put<const N: usize>(&mut self, value: [u8; N]) -> Done {
        let length = (self.bytes.len() - HEADER.len()).next_multiple_of(N) + HEADER.len();
        self.bytes.resize(length, 0);
        self.bytes.extend_from_slice(&value);
        Ok(())
    }

    /// The length of a sequence, before its elements.
    fn count(&mut self, count: usize) -> Done {
        self.put(u32::try_from(count).map_err(|_| fmt::Error)?.to_le_bytes())
    }
}

impl Serializer for &mut Writer {
    type Ok = ();
    type Error = fmt::Error;
    type SerializeSeq = Self;
    type SerializeTuple = Self;
    type SerializeTupleStruct = Impossible<(), fmt::Error>;
    type SerializeTupleVariant = Impossible<(), fmt::Error>;
    type SerializeMap = Impossible<(), fmt::Error>;
    type SerializeStruct = Self;
    type SerializeStructVariant = Impossible<(), fmt::Error>;

    fn serialize_bool(self, value: bool) -> Done {
        self.put([u8::from(value)])
    }

    fn serialize_i8(self, value: i8) -> Done {
        self.put(value.to_le_bytes())
    }

    fn serialize_i16(self, value: i16) -> Done {
        self.put(value.to_le_bytes())
    }

    fn serialize_i32(self, value: i32) -> Done {
        self.put(value.to_le_bytes())
    }

    fn serialize_i64(self, value: i64) -> Done {
        self.put(value.to_le_bytes())
    }

    fn serialize_u8(self, value: u8) -> Done {
        self.put([value])
    }

    fn serialize_u16(self, value: u16) -> Done {
        self.put(value.to_le_bytes())
    }

    fn serialize_u32(self, value: u32) -> Done {
        self.put(value.to_le_bytes())
    }

    fn serialize_u64(self, value: u64) -> Done {
        self.put(value.to_le_bytes())
    }

    fn serialize_f32(self, value: f32) -> Done {
        self.put(value.to_le_bytes())
    }

    fn serialize_f64(self, value: f64) -> Done {
        self.put(value.to_le_bytes())
    }

    fn serialize_char(self, _: char) -> Done {
        Err(fmt::Error)
    }

    fn serialize_str(self, text: &str) -> Done {
        self.count(text.len() + 1)?;
        self.bytes.extend_from_slice(text.as_bytes());
        self.put([0])
    }

    fn serialize_bytes(self, bytes: &[u8]) -> Done {
        self.count(bytes.len())?;
        self.bytes.extend_from_slice(bytes);
        Ok(())
    }

    fn serialize_none(self) -> Done {
        Err(fmt::Error)
    }

    fn serialize_some<T: Serialize + ?Sized>(self, _: &T) -> Done {
        Err(fmt::Error)
    }

    fn serialize_unit(self) -> Done {
        Err(fmt::Error)
    }

    fn serialize_unit_struct(self, _: &'static str) -> Done {
        Err(fmt::Error)
    }

    fn serialize_unit_variant(self, _: &'static str, _: u32, _: &'static str) -> Done {
        Err(fmt::Error)
    }

    fn serialize_newtype_struct<T: Serialize + ?Sized>(self, _: &'static str, value: &T) -> Done {
        value.serialize(self)
    }

    fn serialize_newtype_variant<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
        _: &T,
    ) -> Done {
        Err(fmt::Error)
    }

    fn serialize_seq(self, length: Option<usize>) -> Result<Self, fmt::Error> {
        self.count(length.ok_or(fmt::Error)?)?;
        Ok(self)
    }

    fn serialize_tuple(self, _: usize) -> Result<Self, fmt::Error> {
        Ok(self)
    }

    fn serialize_tuple_struct(
        self,
        _: &'static str,
        _: usize,
    ) -> Result<Self::SerializeTupleStruct, fmt::Error> {
        Err(fmt::Error)
    }

    fn serialize_tuple_variant(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
        _: usize,
    ) -> Result<Self::SerializeTupleVariant, fmt::Error> {
        Err(fmt::Error)
    }

    fn serialize_map(self, _: Option<usize>) -> Result<Self::SerializeMap, fmt::Error> {
        Err(fmt::Error)
    }

    fn serialize_struct(self, _: &'static str, _: usize) -> Result<Self, fmt::Error> {
        Ok(self)
    }

    fn serialize_struct_variant(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
        _: usize,
    ) -> Result<Self::SerializeStructVariant, fmt::Error> {
        Err(fmt::Error)
    }

    fn is_human_readable(&self) -> bool {
        false
    }
}

impl SerializeSeq for &mut Writer {
    type Ok = ();
    type Error = fmt::Error;

    fn serialize_element<T: Serialize + ?Sized>(&mut self, value: &T) -> Done {
        value.serialize(&mut **self)
    }

    fn end(self) -> Done {
        Ok(())
    }
}

impl SerializeTuple for &mut Writer {
    type Ok = ();
    type Error = fmt::Error;

    fn serialize_element<T: Serialize + ?Sized>(&mut self, value: &T) -> Done {
        value.serialize(&mut **self)
    }

    fn end(self) -> Done {
        Ok(())
    }
}

impl SerializeStruct for &mut Writer {
    type Ok = ();
    type Error = fmt::Error;

    fn serialize_field<T: Serialize + ?Sized>(&mut self, _: &'static str, value: &T) -> Done {
        value.serialize(&mut **self)
    }

    fn end(self) -> Done {
        Ok(())
    }
}

/// Reads one message. Every method gives `None` where the message is too short.
#[derive(Debug)]
pub struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    /// `None` where the header is another.
    pub fn new(message: &'a [u8]) -> Option<Self> {
        Some(Reader { bytes: message.strip_prefix(&HEADER)?, at: 0 })
    }

    fn get<const N: usize>(&mut self) -> Option<[u8; N]> {
        let from = self.at.next_multiple_of(N);
        let value = self.bytes.get(from..from.checked_add(N)?)?.try_into().ok()?;
        self.at = from + N;
        Some(value)
    }

    /// `uint8`.
    pub fn u8(&mut self) -> Option<u8> {
        self.get().map(u8::from_le_bytes)
    }

    /// `int32`.
    pub fn i32(&mut self) -> Option<i32> {
        self.get().map(i32::from_le_bytes)
    }

    /// `uint32`.
    pub fn u32(&mut self) -> Option<u32> {
        self.get().map(u32::from_le_bytes)
    }

    /// `uint64`.
    pub fn u64(&mut self) -> Option<u64> {
        self.get().map(u64::from_le_bytes)
    }

    /// `uint8[]`.
    pub fn blob(&mut self) -> Option<&'a [u8]> {
        let length = self.u32()? as usize;
        let found = self.bytes.get(self.at..self.at.checked_add(length)?)?;
        self.at += length;
        Some(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Serialize)]
    struct Inner<'a> {
        flag: bool,
        data: &'a [u8],
    }

    #[derive(Serialize)]
    struct Example<'a> {
        kind: u8,
        count: u32,
        text: &'a str,
        value: f64,
        pair: [i16; 2],
        many: Vec<Inner<'a>>,
    }

    #[test]
    fn fields_are_aligned_behind_the_header_and_texts_end_in_zero() {
        let many = vec![Inner { flag: true, data: &[9, 8] }];
        let message =
            encode(&Example { kind: 7, count: 1, text: "ab", value: 1.5, pair: [-1, 2], many }).unwrap();
        let mut expected = vec![0, 1, 0, 0, 7, 0, 0, 0, 1, 0, 0, 0, 3, 0, 0, 0, b'a', b'b', 0];
        // 15 bytes behind the header: one of padding before the double.
        expected.push(0);
        expected.extend(1.5_f64.to_le_bytes());
        // An array has no length; a sequence has.
        expected.extend([255, 255, 2, 0, 1, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 9, 8]);
        assert_eq!(message, expected);
    }

    #[test]
    fn what_no_message_of_ros_has_is_an_error() {
        assert!(encode(&Some(1)).is_err());
        assert!(encode(&()).is_err());
        assert!(encode(&std::collections::BTreeMap::from([(1, 2)])).is_err());
    }

    #[test]
    fn what_is_cut_short_or_of_another_kind_is_none() {
        let message = encode(&(1_u8, 5_u64, b"xyz".as_slice())).unwrap();
        let read = |bytes: &[u8]| {
            let mut reader = Reader::new(bytes)?;
            Some((reader.u8()?, reader.u64()?, reader.blob()?.to_vec()))
        };
        assert_eq!(read(&message), Some((1, 5, b"xyz".to_vec())));
        for length in 0..message.len() {
            assert_eq!(read(&message[..length]), None);
        }
        let mut other = message.clone();
        other[1] = 0;
        assert_eq!(read(&other), None);
    }
}
