//! A pseudo-terminal as a board's port, at a path that stays the same when the cable is plugged in again.

use std::io::{ErrorKind, Read as _, Write as _};
use std::os::fd::{FromRawFd as _, IntoRawFd as _, OwnedFd};
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serialport::{SerialPort as _, TTYPort};

static STARTING: Mutex<()> = Mutex::new(());

/// A program that is started while a pseudo-terminal is being made would inherit the board's end, and no
/// cable would ever be pulled: whoever starts one holds this.
pub fn alone() -> MutexGuard<'static, ()> {
    STARTING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A pseudo-terminal: the board's end, which no program inherits, and the laptop's.
///
/// # Panics
/// If the system has none left.
pub fn pair() -> (TTYPort, TTYPort) {
    let _alone = alone();
    let (board, laptop) = TTYPort::pair().expect("a pseudo-terminal");
    // Safety: the port gives its descriptor away and is gone. The copy is not inherited by programs.
    let board = unsafe { OwnedFd::from_raw_fd(board.into_raw_fd()) };
    let copy = board.try_clone().expect("a descriptor");
    // SAFETY: as above.
    (unsafe { TTYPort::from_raw_fd(copy.into_raw_fd()) }, laptop)
}

/// The board's end of a cable.
pub struct Port {
    place: PathBuf,
    board: Option<TTYPort>,
}

impl Port {
    /// A port that will be at this path; the cable is not plugged in.
    pub fn new(place: PathBuf) -> Self {
        Self { place, board: None }
    }

    /// Is the cable plugged in?
    pub fn is_plugged(&self) -> bool {
        self.board.is_some()
    }

    /// Plugs the cable in: the path appears.
    ///
    /// # Panics
    /// If the system has no pseudo-terminal left.
    pub fn plug(&mut self) {
        let (mut port, laptop) = pair();
        port.set_timeout(Duration::ZERO).expect("a timeout");
        // Renamed into its place, so that nobody ever finds half a link.
        let fresh = self.place.with_extension("new");
        let _ = std::fs::remove_file(&fresh);
        std::os::unix::fs::symlink(laptop.name().expect("a name"), &fresh).expect("a link");
        std::fs::rename(&fresh, &self.place).expect("a link");
        self.board = Some(port);
    }

    /// Pulls the cable: the path is gone, and whoever has it open is told.
    pub fn pull(&mut self) {
        let _ = std::fs::remove_file(&self.place);
        self.board = None;
    }

    /// Sends to the laptop what the port accepts; the rest is lost, as on a real line.
    pub fn write(&mut self, mut bytes: &[u8]) {
        let Some(port) = &mut self.board else { return };
        while !bytes.is_empty() {
            match port.write(bytes) {
                Ok(count @ 1..) => bytes = &bytes[count..],
                _ => return,
            }
        }
    }

    /// What the laptop has sent, and whether it has the port open. Waits for nothing.
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
