//! A simulated left board whose delays, silence and floods a test controls.
//! Each message is valid by itself, and the test sets its content.
//! The board uses wall-clock time, because the tests depend on the operating system's behaviour.
//! The tests cover programs that are stopped, flooded or without a reader.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{Read as _, Write as _};
use std::os::fd::{FromRawFd as _, IntoRawFd as _, OwnedFd};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serialport::{SerialPort as _, TTYPort};
use shared_proto::frame::{BOARD_FRAME_MAX, DELIMITER, Decoder, HOST_FRAME_MAX, encode_board};
use shared_proto::message::{
    Ack, AckResult, Board, BoardMessage, Heading, Hello, HostMessage, LeftState, PROTOCOL_MAJOR,
    PROTOCOL_MINOR, Pong, Text,
};

use crate::desk::port::pair;

const STATE_INTERVAL: Duration = Duration::from_millis(20);

/// Additional data that the board sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flood {
    /// The board sends zeros as fast as the line accepts them.
    Zeros,
    /// The newest state, sent repeatedly in valid frames.
    States,
    /// Repeated hello messages of one board.
    Hellos,
}

/// The current settings of the test.
#[derive(Clone, Copy, Debug)]
pub struct Wish {
    pub heading: Heading,
    pub silent: bool,
    /// Delay of all data that the board sends.
    pub delay: Duration,
    pub flood: Option<Flood>,
    over: bool,
}

/// The board on its pseudo-terminal. Its thread ends when this is dropped.
pub struct Talker {
    wish: Arc<Mutex<Wish>>,
    said: Arc<Mutex<Instant>>,
    thread: Option<JoinHandle<()>>,
    port: PathBuf,
}

fn lock<T>(what: &Mutex<T>) -> MutexGuard<'_, T> {
    what.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Talker {
    pub fn start(folder: &Path) -> Self {
        let (board, laptop) = pair();
        // Safety: the port gives up ownership of its descriptor.
        let board = File::from(unsafe { OwnedFd::from_raw_fd(board.into_raw_fd()) });
        // A board never waits for a reader of its data.
        rustix::io::ioctl_fionbio(&board, true).unwrap();
        let port = folder.join("talker");
        let _ = std::fs::remove_file(&port);
        std::os::unix::fs::symlink(laptop.name().expect("a name"), &port).unwrap();
        let wish = Wish {
            heading: Heading::Neutral,
            silent: false,
            delay: Duration::ZERO,
            flood: None,
            over: false,
        };
        let (wish, said) = (Arc::new(Mutex::new(wish)), Arc::new(Mutex::new(Instant::now())));
        let machine = Machine {
            board,
            _laptop: laptop,
            wish: Arc::clone(&wish),
            said: Arc::clone(&said),
            began: Instant::now(),
            sequence: 0,
            waiting: VecDeque::new(),
        };
        let thread = Some(std::thread::spawn(move || machine.run()));
        Talker { wish, said, thread, port }
    }

    pub fn port(&self) -> String {
        self.port.display().to_string()
    }

    /// Changes the settings.
    pub fn set(&self, change: impl FnOnce(&mut Wish)) {
        change(&mut lock(&self.wish));
    }

    pub fn point(&self, heading: Heading) {
        self.set(|wish| wish.heading = heading);
    }

    /// The time at which the last state was sent.
    pub fn last_state(&self) -> Instant {
        *lock(&self.said)
    }
}

impl Drop for Talker {
    fn drop(&mut self) {
        self.set(|wish| wish.over = true);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

struct Machine {
    board: File,
    /// This is kept open, so that the board's side remains valid while no program has the port open.
    _laptop: TTYPort,
    wish: Arc<Mutex<Wish>>,
    said: Arc<Mutex<Instant>>,
    began: Instant,
    sequence: u16,
    /// Bytes that have not reached the laptop yet.
    waiting: VecDeque<(Instant, Vec<u8>)>,
}

fn encode(message: &BoardMessage<'_>) -> Vec<u8> {
    encode_board(message, &mut [0; BOARD_FRAME_MAX]).expect("fits").to_vec()
}

impl Machine {
    fn now_ms(&self) -> u32 {
        self.began.elapsed().as_millis() as u32
    }

    fn hello(&self) -> Vec<u8> {
        encode(&BoardMessage::Hello(Hello {
            major: PROTOCOL_MAJOR,
            minor: PROTOCOL_MINOR,
            board: Board::LeftNano,
            firmware: Text("0.1.0"),
            boot_id: 4711,
            model_id: 0,
            sample_hz: 100,
        }))
    }

    fn state(&self, heading: Heading) -> Vec<u8> {
        let state = LeftState {
            sequence: self.sequence,
            board_time_ms: self.now_ms(),
            heading,
            ..LeftState::default()
        };
        encode(&BoardMessage::Left(state))
    }

    fn run(mut self) {
        let mut decoder = Decoder::<HOST_FRAME_MAX>::new();
        let mut next_state = Instant::now();
        let mut buffer = [0; 512];
        self.waiting.push_back((Instant::now(), vec![DELIMITER]));
        loop {
            let wish = *lock(&self.wish);
            if wish.over {
                return;
            }
            let read = self.board.read(&mut buffer).unwrap_or(0);
            if read == 0 && wish.flood.is_none() {
                std::thread::sleep(Duration::from_micros(500));
            }
            let due = Instant::now() + wish.delay;
            for &byte in &buffer[..read] {
                let answer = match decoder.push_host(byte) {
                    Some(HostMessage::HelloRequest) => self.hello(),
                    Some(HostMessage::Ping { id }) => {
                        encode(&BoardMessage::Pong(Pong { id, board_time_ms: self.now_ms() }))
                    }
                    Some(
                        HostMessage::SetThresholds { request, .. } | HostMessage::SetMode { request, .. },
                    ) => encode(&BoardMessage::Ack(Ack { request, result: AckResult::Ok, next_offset: 0 })),
                    _ => continue,
                };
                self.waiting.push_back((due, answer));
            }
            if Instant::now() >= next_state {
                next_state = Instant::now() + STATE_INTERVAL;
                if !wish.silent {
                    self.sequence = self.sequence.wrapping_add(1);
                    self.waiting.push_back((due, self.state(wish.heading)));
                    *lock(&self.said) = Instant::now();
                }
            }
            while self.waiting.front().is_some_and(|(due, _)| *due <= Instant::now()) {
                let (_, bytes) = self.waiting.pop_front().expect("it was there");
                let _ = self.board.write(&bytes);
            }
            if let Some(flood) = wish.flood {
                let chunk = match flood {
                    Flood::Zeros => vec![0; 16 * 1024],
                    Flood::States => self.state(wish.heading).repeat(600),
                    Flood::Hellos => self.hello().repeat(400),
                };
                let until = Instant::now() + Duration::from_millis(5);
                while Instant::now() < until {
                    if self.board.write(&chunk).is_err() {
                        std::thread::yield_now();
                    }
                }
            }
        }
    }
}
