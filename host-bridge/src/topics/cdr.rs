//! CDR, little endian, as ROS 2 writes its messages: four bytes of header, then the fields in turn, each
//! aligned to its size as counted from behind the header.

/// Writes one message.
#[derive(Debug)]
pub struct Writer {
    bytes: Vec<u8>,
}

/// Marks CDR, little endian.
const HEADER: [u8; 4] = [0, 1, 0, 0];

impl Writer {
    /// An empty message.
    pub fn new() -> Self {
        Writer { bytes: HEADER.to_vec() }
    }

    fn put<const N: usize>(&mut self, value: [u8; N]) -> &mut Self {
        while !(self.bytes.len() - HEADER.len()).is_multiple_of(N) {
            self.bytes.push(0);
        }
        self.bytes.extend_from_slice(&value);
        self
    }

    /// `uint8`.
    pub fn u8(&mut self, value: u8) -> &mut Self {
        self.put([value])
    }

    /// `int16`.
    pub fn i16(&mut self, value: i16) -> &mut Self {
        self.put(value.to_le_bytes())
    }

    /// `uint16`.
    pub fn u16(&mut self, value: u16) -> &mut Self {
        self.put(value.to_le_bytes())
    }

    /// `int32`.
    pub fn i32(&mut self, value: i32) -> &mut Self {
        self.put(value.to_le_bytes())
    }

    /// `uint32`.
    pub fn u32(&mut self, value: u32) -> &mut Self {
        self.put(value.to_le_bytes())
    }

    /// `uint64`.
    pub fn u64(&mut self, value: u64) -> &mut Self {
        self.put(value.to_le_bytes())
    }

    /// `float32`.
    pub fn f32(&mut self, value: f32) -> &mut Self {
        self.put(value.to_le_bytes())
    }

    /// `float64`.
    pub fn f64(&mut self, value: f64) -> &mut Self {
        self.put(value.to_le_bytes())
    }

    /// `float64[N]`, or any run of such fields.
    pub fn f64s(&mut self, values: &[f64]) -> &mut Self {
        for value in values {
            self.f64(*value);
        }
        self
    }

    /// The length of a sequence, before its elements.
    pub fn count(&mut self, count: usize) -> &mut Self {
        self.u32(u32::try_from(count).unwrap_or(u32::MAX))
    }

    /// `string`.
    pub fn string(&mut self, text: &str) -> &mut Self {
        self.count(text.len() + 1);
        self.bytes.extend_from_slice(text.as_bytes());
        self.bytes.push(0);
        self
    }

    /// `uint8[]`.
    pub fn blob(&mut self, bytes: &[u8]) -> &mut Self {
        self.count(bytes.len());
        self.bytes.extend_from_slice(bytes);
        self
    }

    /// The message.
    pub fn take(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.bytes)
    }
}

impl Default for Writer {
    fn default() -> Self {
        Writer::new()
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

    #[test]
    fn fields_are_aligned_behind_the_header_and_texts_end_in_zero() {
        let mut writer = Writer::new();
        let message = writer.u8(7).u32(1).string("ab").f64(1.5).blob(&[9, 8]).take();
        let mut expected = vec![0, 1, 0, 0, 7, 0, 0, 0, 1, 0, 0, 0, 3, 0, 0, 0, b'a', b'b', 0];
        // 15 bytes behind the header: one of padding before the double.
        expected.push(0);
        expected.extend(1.5_f64.to_le_bytes());
        expected.extend([2, 0, 0, 0, 9, 8]);
        assert_eq!(message, expected);
    }

    #[test]
    fn what_is_cut_short_or_of_another_kind_is_none() {
        let message = Writer::new().u8(1).u64(5).blob(b"xyz").take();
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
