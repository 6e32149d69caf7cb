//! Reads the records of a file, including those in compressed chunks, with limited memory.

use mcap::read::parse_record;
use mcap::records::Record;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{McapError, McapResult};

/// Maximum length of a record; the longest records of our files have some KiB.
/// The library allocates the length that a record claims, which can be arbitrary in a damaged file.
const RECORD_MAX: usize = 16 << 20;

/// Reads a file up to its end or to a damaged place. The regular end may be missing.
pub struct Records<'a> {
    bytes: &'a [u8],
    reader: LinearReader,
    /// Set after an error, because the data that follows is unknown.
    over: bool,
}

/// Returns the records of these bytes.
///
/// # Errors
/// Fails if the data does not begin like an MCAP file.
pub fn records(bytes: &[u8]) -> McapResult<Records<'_>> {
    // The lenient reader would accept an empty file as a file without an end.
    if !bytes.starts_with(mcap::MAGIC) {
        return Err(McapError::BadMagic);
    }
    let options =
        LinearReaderOptions::default().with_skip_end_magic(true).with_record_length_limit(RECORD_MAX);
    Ok(Records { bytes, reader: LinearReader::new_with_options(options), over: false })
}

impl Iterator for Records<'_> {
    type Item = McapResult<Record<'static>>;

    fn next(&mut self) -> Option<Self::Item> {
        while !self.over {
            match self.reader.next_event()? {
                Ok(LinearReadEvent::ReadRequest(wanted)) => {
                    let (now, rest) = self.bytes.split_at(wanted.min(self.bytes.len()));
                    self.reader.insert(now.len()).copy_from_slice(now);
                    self.reader.notify_read(now.len());
                    self.bytes = rest;
                }
                Ok(LinearReadEvent::Record { data, opcode }) => {
                    let record = parse_record(opcode, data).map(Record::into_owned);
                    self.over = record.is_err();
                    return Some(record);
                }
                Err(error) => {
                    self.over = true;
                    return Some(Err(error));
                }
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file() -> Vec<u8> {
        let mut bytes = std::io::Cursor::new(Vec::new());
        let options = mcap::WriteOptions::new().compression(Some(mcap::Compression::Zstd));
        let mut writer = options.create(&mut bytes).unwrap();
        let channel = writer.add_channel(0, "/a", "cdr", &Default::default()).unwrap();
        for time in 0..3 {
            let header = mcap::records::MessageHeader {
                channel_id: channel,
                sequence: 0,
                log_time: time,
                publish_time: time,
            };
            writer.write_to_known_channel(&header, &[1, 2, 3]).unwrap();
        }
        writer.finish().unwrap();
        drop(writer);
        bytes.into_inner()
    }

    #[test]
    fn records_are_read_without_the_end_and_a_length_that_none_has_is_an_error() {
        let file = file();
        let messages = |bytes: &[u8]| {
            records(bytes).unwrap().filter(|record| matches!(record, Ok(Record::Message { .. }))).count()
        };
        assert_eq!((messages(&file), messages(&file[..file.len() - 40])), (3, 3));
        assert!(records(&file[..4]).is_err() && records(b"").is_err());
        // The first record, the header, claims an impossible length.
        let mut claims = file;
        claims[8 + 1 + 7] = 0x17;
        assert!(records(&claims).unwrap().next().unwrap().is_err());
    }
}
