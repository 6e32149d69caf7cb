//! A file that is a valid MCAP file after every write.
//!
//! The last chunk is followed by the shortest valid end.
//! The next chunk overwrites this end, with a new end, in a single write.
//! After a kill or on a full disk, the file is therefore readable up to its last chunk.
//! After a kill, only the index is missing.

use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};

/// A data end without checksum, a footer without summary, and the magic bytes.
pub(super) const END: [u8; 50] = {
    let mut end = [0; 50];
    // Operation code and length of the record, followed by zeros.
    end[0] = 0x0f;
    end[1] = 4;
    end[13] = 0x02;
    end[14] = 20;
    let magic = [0x89, b'M', b'C', b'A', b'P', 0x30, b'\r', b'\n'];
    let mut i = 0;
    while i < magic.len() {
        end[42 + i] = magic[i];
        i += 1;
    }
    end
};

/// The operations that a file must support. The tests implement a file that fails.
pub trait Storage {
    /// Writes all bytes at this position.
    ///
    /// # Errors
    /// Returns the error of the disk. Some of the bytes may have been written.
    fn write_at(&mut self, at: u64, bytes: &[u8]) -> io::Result<()>;

    /// Removes everything after this position.
    ///
    /// # Errors
    /// Returns the file system's error message.
    fn cut(&mut self, length: u64) -> io::Result<()>;
}

impl Storage for File {
    fn write_at(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        self.seek(SeekFrom::Start(at))?;
        self.write_all(bytes)
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.set_len(length)
    }
}

/// Collects bytes. A flush writes them to the disk, followed by an end.
#[derive(Debug)]
pub struct Sink<S: Storage> {
    storage: S,
    /// The file is valid up to this position.
    good: u64,
    waiting: Vec<u8>,
    failed: bool,
}

impl<S: Storage> Sink<S> {
    /// Creates a sink that writes from the start of the storage.
    pub fn new(storage: S) -> Self {
        Sink { storage, good: 0, waiting: Vec::new(), failed: false }
    }

    /// Returns the length of the file on the disk, including its end.
    pub fn length(&self) -> u64 {
        if self.good > 0 { self.good + END.len() as u64 } else { 0 }
    }

    fn put(&mut self, end: &[u8]) -> io::Result<()> {
        if self.failed {
            return Err(io::Error::other("the file could not be written before"));
        }
        let length = self.waiting.len() as u64;
        self.waiting.extend_from_slice(end);
        if let Err(error) = self.storage.write_at(self.good, &self.waiting) {
            self.failed = true;
            self.waiting.clear();
            // The new end fits in the place of the old one.
            if self.good > 0 {
                self.storage.cut(self.good + END.len() as u64)?;
                self.storage.write_at(self.good, &END)?;
            }
            return Err(error);
        }
        self.good += length;
        self.waiting.clear();
        Ok(())
    }

    /// Writes the last bytes, which contain their own end.
    ///
    /// # Errors
    /// Returns the error of the disk. The file is valid even then.
    pub fn finish(mut self) -> io::Result<(S, u64)> {
        self.put(&[])?;
        self.storage.cut(self.good)?;
        Ok((self.storage, self.good))
    }
}

impl<S: Storage> Write for Sink<S> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.failed {
            return Err(io::Error::other("the file could not be written before"));
        }
        self.waiting.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        if self.waiting.is_empty() {
            return Ok(());
        }
        self.put(&END)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;
    use std::rc::Rc;

    /// A disk with this many bytes.
    struct Small(Rc<RefCell<Vec<u8>>>, usize);

    impl Storage for Small {
        fn write_at(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
            let mut disk = self.0.borrow_mut();
            let at = at as usize;
            let fits = bytes.len().min(self.1.saturating_sub(at));
            let end = (at + fits).max(disk.len());
            disk.resize(end, 0);
            disk[at..at + fits].copy_from_slice(&bytes[..fits]);
            if fits < bytes.len() { Err(io::ErrorKind::StorageFull.into()) } else { Ok(()) }
        }

        fn cut(&mut self, length: u64) -> io::Result<()> {
            self.0.borrow_mut().resize(length as usize, 0);
            Ok(())
        }
    }

    #[test]
    fn after_every_flush_and_on_a_full_disk_the_file_ends_as_it_must() {
        let disk = Rc::new(RefCell::new(Vec::new()));
        let mut sink = Sink::new(Small(disk.clone(), 200));
        sink.write_all(&[1; 40]).unwrap();
        assert!(disk.borrow().is_empty());
        sink.flush().unwrap();
        sink.write_all(&[2; 40]).unwrap();
        sink.flush().unwrap();
        let whole = [&[1; 40][..], &[2; 40], &END].concat();
        assert_eq!(*disk.borrow(), whole);
        sink.write_all(&[3; 300]).unwrap();
        assert_eq!(sink.flush().unwrap_err().kind(), io::ErrorKind::StorageFull);
        assert_eq!(*disk.borrow(), whole);
        sink.write_all(&[4]).unwrap_err();
        assert!(sink.finish().is_err());
        assert_eq!(*disk.borrow(), whole);
    }

    #[test]
    fn the_writers_own_end_takes_the_place_of_ours() {
        let disk = Rc::new(RefCell::new(Vec::new()));
        let mut sink = Sink::new(Small(disk.clone(), 200));
        sink.write_all(&[1; 40]).unwrap();
        sink.flush().unwrap();
        sink.write_all(b"end").unwrap();
        assert_eq!(sink.finish().unwrap().1, 43);
        assert_eq!(*disk.borrow(), [&[1; 40][..], b"end"].concat());
    }
}
