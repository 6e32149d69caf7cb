//! A pseudo-terminal as a board's port, with a path that stays the same when the cable is reconnected.

use std::io::{ErrorKind, Read as _, Write as _};
use std::os::fd::{FromRawFd as _, IntoRawFd as _, OwnedFd};
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serialport::{SerialPort as _, TTYPort};

static STARTING: Mutex<()> = Mutex::new(());

/// A lock that every start of a program must hold.
/// A program that starts while a pseudo-terminal is created would inherit the board's side.
/// The test could then no longer disconnect the cable.
pub fn alone() -> MutexGuard<'static, ()> {
    STARTING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns both sides of a pseudo-terminal:
/// the board's side, which no program inherits, and the laptop's side.
///
/// # Panics
/// Panics if the system has no free pseudo-terminal.
pub fn pair() -> (TTYPort, TTYPort) {
    let _alone = alone();
    let (board, laptop) = TTYPort::pair().expect("a pseudo-terminal");
    // Safety: the port gives up ownership of its descriptor. Programs do not inherit the copied descriptor.
    let board = unsafe { OwnedFd::from_raw_fd(board.into_raw_fd()) };
    let copy = board.try_clone().expect("a descriptor");
    // SAFETY: this is the same case as above.
    (unsafe { TTYPort::from_raw_fd(copy.into_raw_fd()) }, laptop)
}

/// The board's side of a cable.
pub struct Port {
    place: PathBuf,
    board: Option<TTYPort>,
}

impl Port {
    /// Creates a port with this path. The cable is not connected yet.
    pub fn new(place: PathBuf) -> Self {
        Self { place, board: None }
    }

    /// Returns whether the cable is connected.
    pub fn is_plugged(&self) -> bool {
        self.board.is_some()
    }

    /// Connects the cable, which creates the path.
    ///
    /// # Panics
    /// Panics if the system has no free pseudo-terminal.
    pub fn plug(&mut self) {
        let (mut port, laptop) = pair();
        port.set_timeout(Duration::ZERO).expect("a timeout");
        // The link is created under another name and then renamed, so that it always appears complete.
        let fresh = self.place.with_extension("new");
        let _ = std::fs::remove_file(&fresh);
        std::os::unix::fs::symlink(laptop.name().expect("a name"), &fresh).expect("a link");
        std::fs::rename(&fresh, &self.place).expect("a link");
        self.board = Some(port);
    }

    /// Disconnects the cable: the path disappears, and programs that use the port get an error.
    pub fn pull(&mut self) {
        let _ = std::fs::remove_file(&self.place);
        self.board = None;
    }

    /// Sends data to the laptop. Data that the port does not accept is lost, as on a real line.
    pub fn write(&mut self, mut bytes: &[u8]) {
        let Some(port) = &mut self.board else { return };
        while !bytes.is_empty() {
            match port.write(bytes) {
                Ok(count @ 1..) => bytes = &bytes[count..],
                _ => return,
            }
        }
    }

    /// Reads the laptop's data without waiting, and returns whether the laptop has the port open.
    pub fn read(&mut self, into: &mut Vec<u8>) -> bool {
        let Some(port) = &mut self.board else { return false };
        let mut buffer = [0; 1024];
        loop {
            match port.read(&mut buffer) {
                Ok(count) => into.extend_from_slice(&buffer[..count]),
                Err(error) => return matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted),
            }
        }
    }
}

impl Drop for Port {
    fn drop(&mut self) {
        self.pull();
    }
}
