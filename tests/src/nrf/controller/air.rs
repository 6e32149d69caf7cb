//! Starts and talks to the other process (`tests/bumble/peer.py`).
//! The other process runs bumble's controllers and the radio link between them.
//! It also runs bumble's device, which acts as the laptop.
//! The process stays in step with the emulated board's virtual time.

use std::collections::VecDeque;
use std::io::{BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::{Arc, Mutex};

use serde_json::Value;

/// A kind of request to the other process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ask {
    /// Passes HCI packets on from a board, and lets time advance.
    Packets = 0,
    /// Neither side has heard the other for as long as the supervision time-out.
    Lost = 1,
    /// The board was reset, so its radio is silent.
    Silent = 2,
    /// The laptop must perform an action.
    Laptop = 3,
}

/// This value in an answer means that the laptop has sent it, and not a board.
const LAPTOP: u8 = 0xFF;

/// The other process, and what it has reported.
pub struct Air {
    child: Child,
    to: ChildStdin,
    from: BufReader<ChildStdout>,
    /// Cycle at which the process's next timer expires.
    pub(super) due: u64,
    /// HCI packets for each board.
    pub(super) inbox: [VecDeque<Vec<u8>>; 2],
    /// What the laptop did and noticed, with the cycle of each entry.
    pub log: Vec<(u64, Value)>,
    orders: u64,
}

impl Air {
    /// Starts the process.
    ///
    /// # Panics
    /// Panics if the process does not start. `BIMANUAL_BUMBLE_PYTHON` selects the Python that has bumble.
    /// By default, this is the Python that `cargo xtask test` sets up.
    pub fn start() -> Arc<Mutex<Self>> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let python = std::env::var_os("BIMANUAL_BUMBLE_PYTHON")
            .unwrap_or_else(|| root.join("../target/venv/bin/python").into());
        let mut child = Command::new(&python)
            .arg(root.join("bumble/peer.py"))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap_or_else(|e| {
                panic!("{}: {e}; `cargo xtask test --only packages` makes it", python.display())
            });
        let to = child.stdin.take().expect("asked for");
        let from = BufReader::new(child.stdout.take().expect("asked for"));
        Arc::new(Mutex::new(Self {
            child,
            to,
            from,
            due: 0,
            inbox: Default::default(),
            log: Vec::new(),
            orders: 0,
        }))
    }

    fn read<const N: usize>(&mut self) -> [u8; N] {
        let mut bytes = [0; N];
        self.from
            .read_exact(&mut bytes)
            .expect("bumble's process answers; its own words are on the terminal");
        bytes
    }

    /// Sends a request, and stores everything that the process reports by this time.
    pub(super) fn ask(&mut self, what: Ask, board: u8, now: u64, content: &[u8]) {
        let mut request = vec![what as u8, board];
        request.extend(now.to_le_bytes());
        request.extend((content.len() as u32).to_le_bytes());
        request.extend(content);
        self.to.write_all(&request).and_then(|()| self.to.flush()).expect("bumble's process listens");
        self.due = u64::from_le_bytes(self.read());
        for _ in 0..u32::from_le_bytes(self.read()) {
            let [who] = self.read();
            let mut bytes = vec![0; u32::from_le_bytes(self.read()) as usize];
            self.from.read_exact(&mut bytes).expect("bumble's process answers");
            if who == LAPTOP {
                self.log.push((now, serde_json::from_slice(&bytes).expect("JSON")));
            } else {
                self.inbox[usize::from(who)].push_back(bytes);
            }
        }
    }

    /// Tells the laptop to perform an action.
    /// Returns the number under which the log will contain the outcome.
    pub(super) fn order(&mut self, now: u64, mut order: Value) -> u64 {
        self.orders += 1;
        order["id"] = self.orders.into();
        self.ask(Ask::Laptop, 0, now, order.to_string().as_bytes());
        self.orders
    }

    /// Returns the outcome of an order if the log contains it.
    pub fn outcome(&self, order: u64) -> Option<&Value> {
        self.log.iter().map(|(_, said)| said).find(|said| said["id"] == order)
    }
}

impl Drop for Air {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
