//! Generates arbitrary messages of every kind from random data.
#![allow(dead_code)] // each test file uses its part

use serde::Deserialize;
use serde::de::value::{Error, U32Deserializer};
use serde::de::{
    DeserializeSeed, Deserializer, EnumAccess, IntoDeserializer, SeqAccess, VariantAccess, Visitor,
};
use serde::forward_to_deserialize_any;
use shared_proto::message::*;

mod rng;
pub use rng::Rng;

/// The random data from which one message is generated.
#[derive(Clone, Debug)]
pub struct Material {
    pub kind: usize,
    pub words: [u32; 10],
    pub bytes: Vec<u8>,
    pub text: String,
}

/// Number of kinds of [`BoardMessage`] and [`HostMessage`].
pub const BOARD_KINDS: usize = BoardMessage::ROWS.len();
pub const HOST_KINDS: usize = HostMessage::ROWS.len();

/// Maximum length of the text or bytes in a message. A message has at most one such field.
pub fn longest(message: &str) -> usize {
    match message {
        "Hello" => FIRMWARE_MAX,
        "Right" => SCORES_MAX,
        "RawImu" => RAW_COUNTS_MAX,
        "ModelInfo" | "ModelBegin" => LABELS_MAX,
        "ModelChunk" => MODEL_CHUNK_MAX,
        _ => 0,
    }
}

impl Material {
    pub fn random(rng: &mut Rng) -> Self {
        let word = |rng: &mut Rng| {
            let bits = rng.next();
            // Generates many small numbers and zeros, as real frames contain, and the limits of each range.
            match bits >> 61 {
                0 | 1 => 0,
                2 => u32::MAX,
                3 | 4 => (bits as u32) & 0xFF,
                5 => (bits as u32) & 0xFFFF,
                _ => bits as u32,
            }
        };
        let kind = rng.below(BOARD_KINDS * HOST_KINDS);
        let words = std::array::from_fn(|_| word(rng));
        let len = rng.below(RAW_COUNTS_MAX + 1);
        let bytes = (0..len).map(|_| word(rng) as u8).collect();
        let text = (0..rng.below(LABELS_MAX + 1)).map(|_| char::from(b' ' + rng.below(95) as u8)).collect();
        Self { kind, words, bytes, text }
    }

    pub fn board(&self) -> BoardMessage<'_> {
        self.message(self.kind % BOARD_KINDS)
    }

    pub fn host(&self) -> HostMessage<'_> {
        self.message(self.kind % HOST_KINDS)
    }

    /// Serde provides the fields of every message, so this file needs no list of them.
    fn message<'a, M: Deserialize<'a>>(&'a self, kind: usize) -> M {
        M::deserialize(&mut Fields { material: self, kind: Some(kind), used: 0, longest: 0 })
            .expect("messages are of numbers, texts, bytes and lists")
    }
}

/// Fills one field after another.
struct Fields<'a> {
    material: &'a Material,
    /// The number of the message's variant, until it has been used.
    kind: Option<usize>,
    used: usize,
    longest: usize,
}

impl Fields<'_> {
    fn word(&mut self) -> u32 {
        let word = self.material.words[self.used % self.material.words.len()];
        self.used += 1;
        word
    }
}

macro_rules! numbers {
    ($($method:ident => $visit:ident($number:ty),)*) => {
        $(fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
            visitor.$visit(self.word() as $number)
        })*
    };
}

impl<'de> Deserializer<'de> for &mut Fields<'de> {
    type Error = Error;

    numbers! {
        deserialize_u8 => visit_u8(u8),
        deserialize_u16 => visit_u16(u16),
        deserialize_u32 => visit_u32(u32),
        deserialize_i16 => visit_i16(i16),
    }

    fn deserialize_f32<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        visitor.visit_f32(f32::from_bits(self.word()))
    }

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        visitor.visit_bool(self.word() & 1 == 1)
    }

    fn deserialize_str<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        let text = &self.material.text;
        visitor.visit_borrowed_str(&text[..text.floor_char_boundary(self.longest)])
    }

    fn deserialize_bytes<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        let bytes = &self.material.bytes;
        visitor.visit_borrowed_bytes(&bytes[..bytes.len().min(self.longest)])
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, len: usize, visitor: V) -> Result<V::Value, Error> {
        visitor.visit_seq(Rest { fields: self, left: len })
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        self.deserialize_tuple(fields.len(), visitor)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        let variant = match self.kind.take() {
            Some(kind) => {
                self.longest = longest(variants[kind]);
                kind
            }
            None => self.word() as usize % variants.len(),
        };
        visitor.visit_enum(Variant { fields: self, variant: variant as u32 })
    }

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Error> {
        Err(serde::de::Error::custom("a kind of field that no message had so far: give it its values here"))
    }

    forward_to_deserialize_any! {
        i8 i32 i64 u64 f64 char string byte_buf option unit unit_struct newtype_struct seq tuple_struct map identifier
        ignored_any
    }
}

struct Rest<'f, 'a> {
    fields: &'f mut Fields<'a>,
    left: usize,
}

impl<'a> SeqAccess<'a> for Rest<'_, 'a> {
    type Error = Error;

    fn next_element_seed<T: DeserializeSeed<'a>>(&mut self, seed: T) -> Result<Option<T::Value>, Error> {
        if self.left == 0 {
            return Ok(None);
        }
        self.left -= 1;
        seed.deserialize(&mut *self.fields).map(Some)
    }
}

struct Variant<'f, 'a> {
    fields: &'f mut Fields<'a>,
    variant: u32,
}

impl<'f, 'a> EnumAccess<'a> for Variant<'f, 'a> {
    type Error = Error;
    type Variant = &'f mut Fields<'a>;

    fn variant_seed<T: DeserializeSeed<'a>>(self, seed: T) -> Result<(T::Value, Self::Variant), Error> {
        let number: U32Deserializer<Error> = self.variant.into_deserializer();
        Ok((seed.deserialize(number)?, self.fields))
    }
}

impl<'a> VariantAccess<'a> for &mut Fields<'a> {
    type Error = Error;

    fn unit_variant(self) -> Result<(), Error> {
        Ok(())
    }

    fn newtype_variant_seed<T: DeserializeSeed<'a>>(self, seed: T) -> Result<T::Value, Error> {
        seed.deserialize(self)
    }

    fn tuple_variant<V: Visitor<'a>>(self, len: usize, visitor: V) -> Result<V::Value, Error> {
        self.deserialize_tuple(len, visitor)
    }

    fn struct_variant<V: Visitor<'a>>(
        self,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        self.deserialize_tuple(fields.len(), visitor)
    }
}
