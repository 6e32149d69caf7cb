//! Reads the tables of a flatbuffer and checks every access.
//!
//! A table starts with a signed distance back to its vtable.
//! The vtable lists the offset of each field in the table; 0 means that the field is absent.
//! Strings, vectors and sub-tables are forward offsets from their own position.
//! Every access is checked against the buffer.
//! Only vtables are reached backwards, and they contain no offsets, so reading terminates.

use super::TfliteError;

const DAMAGED: TfliteError = TfliteError::Damaged;

/// A position in the buffer, together with the buffer.
#[derive(Clone, Copy)]
pub(super) struct Table<'a> {
    bytes: &'a [u8],
    at: usize,
    vtable: usize,
    vtable_len: usize,
}

fn chunk<const N: usize>(bytes: &[u8], at: usize) -> Result<[u8; N], TfliteError> {
    let rest = bytes.get(at..).ok_or(DAMAGED)?;
    rest.first_chunk::<N>().copied().ok_or(DAMAGED)
}

fn u32_at(bytes: &[u8], at: usize) -> Result<usize, TfliteError> {
    Ok(u32::from_le_bytes(chunk(bytes, at)?) as usize)
}

/// Follows an offset forward.
fn follow(bytes: &[u8], at: usize) -> Result<usize, TfliteError> {
    let to = at.checked_add(u32_at(bytes, at)?).ok_or(DAMAGED)?;
    if to > at && to < bytes.len() { Ok(to) } else { Err(DAMAGED) }
}

impl<'a> Table<'a> {
    /// The table at which the buffer begins.
    pub fn root(bytes: &'a [u8]) -> Result<Self, TfliteError> {
        Self::at(bytes, follow(bytes, 0)?)
    }

    fn at(bytes: &'a [u8], at: usize) -> Result<Self, TfliteError> {
        let back = i32::from_le_bytes(chunk(bytes, at)?);
        let vtable = i64::try_from(at).ok().map(|at| at - i64::from(back)).ok_or(DAMAGED)?;
        let vtable = usize::try_from(vtable).map_err(|_| DAMAGED)?;
        let vtable_len = usize::from(u16::from_le_bytes(chunk(bytes, vtable)?));
        if vtable_len < 4 || bytes.len() - vtable < vtable_len {
            return Err(DAMAGED);
        }
        Ok(Self { bytes, at, vtable, vtable_len })
    }

    /// The position of a field, if the table contains it.
    fn field(&self, id: usize) -> Result<Option<usize>, TfliteError> {
        let slot = 4 + 2 * id;
        if slot + 2 > self.vtable_len {
            return Ok(None);
        }
        let offset = usize::from(u16::from_le_bytes(chunk(self.bytes, self.vtable + slot)?));
        Ok(if offset == 0 { None } else { Some(self.at + offset) })
    }

    pub fn i8(&self, id: usize, default: i8) -> Result<i8, TfliteError> {
        match self.field(id)? {
            Some(at) => Ok(i8::from_le_bytes(chunk(self.bytes, at)?)),
            None => Ok(default),
        }
    }

    pub fn i32(&self, id: usize, default: i32) -> Result<i32, TfliteError> {
        match self.field(id)? {
            Some(at) => Ok(i32::from_le_bytes(chunk(self.bytes, at)?)),
            None => Ok(default),
        }
    }

    pub fn f32(&self, id: usize, default: f32) -> Result<f32, TfliteError> {
        match self.field(id)? {
            Some(at) => Ok(f32::from_le_bytes(chunk(self.bytes, at)?)),
            None => Ok(default),
        }
    }

    pub fn table(&self, id: usize) -> Result<Option<Self>, TfliteError> {
        match self.field(id)? {
            Some(at) => Ok(Some(Self::at(self.bytes, follow(self.bytes, at)?)?)),
            None => Ok(None),
        }
    }

    /// The bytes of a vector whose elements have `size` bytes. An absent vector counts as empty.
    fn vector(&self, id: usize, size: usize) -> Result<(usize, &'a [u8]), TfliteError> {
        let Some(at) = self.field(id)? else { return Ok((0, &[])) };
        let at = follow(self.bytes, at)?;
        let length = u32_at(self.bytes, at)?.checked_mul(size).ok_or(DAMAGED)?;
        let end = (at + 4).checked_add(length).ok_or(DAMAGED)?;
        Ok((at + 4, self.bytes.get(at + 4..end).ok_or(DAMAGED)?))
    }

    pub fn bytes(&self, id: usize) -> Result<&'a [u8], TfliteError> {
        Ok(self.vector(id, 1)?.1)
    }

    pub fn text(&self, id: usize) -> Result<&'a str, TfliteError> {
        std::str::from_utf8(self.bytes(id)?).map_err(|_| DAMAGED)
    }

    pub fn i32s(&self, id: usize) -> Result<Vec<i32>, TfliteError> {
        let (words, _) = self.vector(id, 4)?.1.as_chunks();
        Ok(words.iter().map(|&word| i32::from_le_bytes(word)).collect())
    }

    pub fn f32s(&self, id: usize) -> Result<Vec<f32>, TfliteError> {
        let (words, _) = self.vector(id, 4)?.1.as_chunks();
        Ok(words.iter().map(|&word| f32::from_le_bytes(word)).collect())
    }

    pub fn i64s(&self, id: usize) -> Result<Vec<i64>, TfliteError> {
        let (words, _) = self.vector(id, 8)?.1.as_chunks();
        Ok(words.iter().map(|&word| i64::from_le_bytes(word)).collect())
    }

    pub fn tables(&self, id: usize) -> Result<Vec<Self>, TfliteError> {
        let (start, bytes) = self.vector(id, 4)?;
        (0..bytes.len() / 4).map(|n| Self::at(self.bytes, follow(self.bytes, start + 4 * n)?)).collect()
    }
}
