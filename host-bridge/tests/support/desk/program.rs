//! Runs programs as a user does, and reads their output line by line.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::io::{ErrorKind, Read as _, Write as _};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, Command, ExitStatus, Stdio};
use std::rc::Rc;
use std::time::{Duration, Instant};

use super::time::{Process, Time};

/// Time limit for a wait, so that a test cannot hang forever.
/// The limit uses the test's time, or wall-clock time for programs that do not use the test's time.
pub const PATIENCE: Duration = Duration::from_secs(240);

/// A temporary folder for one test, and the test's time.
pub struct Desk {
    path: PathBuf,
    time: Time,
}

impl Desk {
    /// Creates an empty desk.
    ///
    /// # Panics
    /// Panics if the folder cannot be created.
    pub fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("bimanual-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).expect("a folder");
        let time = Time::start(&path);
        Self { path, time }
    }

    /// Returns the time that all boards and programs on the desk share.
    pub fn time(&self) -> &Time {
        &self.time
    }

    /// Advances the time by this duration.
    pub fn pass(&self, time: Duration) {
        self.time.pass(time);
    }

    /// Returns a path in the desk's folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Returns the same path as text.
    pub fn text(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }

    /// Starts a program that uses the desk's time. Its output is printed immediately.
    ///
    /// # Panics
    /// Panics if the program does not start.
    pub fn start(&self, mut command: Command) -> Running {
        let outputs = outputs(&mut command);
        Running::new(&self.time, self.time.spawn(&mut command), outputs)
    }

    /// Starts a program that uses wall-clock time. The desk's time stands still while a test waits for it.
    ///
    /// # Panics
    /// Panics if the program does not start.
    pub fn start_on_its_own(&self, mut command: Command) -> Running {
        let outputs = outputs(&mut command);
        Running::new(&self.time, Process::on_its_own(&mut command), outputs)
    }

    /// Starts a program with these arguments.
    pub fn run(&self, program: &Path, args: &[&str]) -> Running {
        println!("$ {} {}", program.file_name().unwrap_or_default().display(), args.join(" "));
        let mut command = Command::new(program);
        command.args(args);
        self.start(command)
    }
}

impl Drop for Desk {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.path);
    }
}

/// Connects standard output and standard error to sockets, which can be read without blocking.
fn outputs(command: &mut Command) -> [Output; 2] {
    let pair = || {
        let (ours, theirs) = UnixStream::pair().expect("a pair of sockets");
        ours.set_nonblocking(true).expect("a socket");
        (Output { from: Some(ours), line: Vec::new() }, Stdio::from(OwnedFd::from(theirs)))
    };
    let ((out, its_out), (err, its_err)) = (pair(), pair());
    command.stdin(Stdio::piped()).stdout(its_out).stderr(its_err);
    [out, err]
}

struct Output {
    /// `None` after the program has closed this output.
    from: Option<UnixStream>,
    line: Vec<u8>,
}

impl Output {
    /// Reads the available output. A question without a line break also counts as a line.
    fn read(&mut self, lines: &mut VecDeque<String>) {
        let mut buffer = [0; 4096];
        while let Some(from) = &mut self.from {
            match from.read(&mut buffer) {
                Ok(count @ 1..) => {
                    for &byte in &buffer[..count] {
                        if byte != b'\n' {
                            self.line.push(byte);
                        }
                        if byte == b'\n' || self.line.ends_with(b"press Enter ") {
                            lines.push_back(self.take_line());
                        }
                    }
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Ok(0) | Err(_) => {
                    self.from = None;
                    if !self.line.is_empty() {
                        lines.push_back(self.take_line());
                    }
                }
            }
        }
    }

    fn take_line(&mut self) -> String {
        String::from_utf8_lossy(&std::mem::take(&mut self.line)).into_owned()
    }
}

/// A running program.
pub struct Running {
    time: Time,
    process: Rc<Process>,
    stdin: RefCell<Option<ChildStdin>>,
    outputs: [Output; 2],
    /// Lines that the test has not read yet.
    waiting: VecDeque<String>,
    /// All lines printed so far, on both outputs.
    pub seen: Vec<String>,
}

impl Running {
    fn new(time: &Time, process: Rc<Process>, outputs: [Output; 2]) -> Self {
        let stdin = RefCell::new(process.child().stdin.take());
        Self { time: time.clone(), process, stdin, outputs, waiting: VecDeque::new(), seen: Vec::new() }
    }

    /// Returns the next available line.
    fn next(&mut self) -> Option<String> {
        if self.waiting.is_empty() {
            self.outputs.iter_mut().for_each(|output| output.read(&mut self.waiting));
        }
        let line = self.waiting.pop_front()?;
        println!("  {line}");
        self.seen.push(line.clone());
        Some(line)
    }

    /// Waits for the next line. Returns `None` when the program has ended or at the time limit.
    fn await_next(&mut self, until: &Until) -> Option<String> {
        loop {
            if let Some(line) = self.next() {
                return Some(line);
            }
            if self.outputs.iter().all(|output| output.from.is_none()) || until.is_over(&self.time) {
                return None;
            }
            if self.process.follows() {
                self.time.step();
            } else {
                std::thread::sleep(Duration::from_millis(1));
            }
        }
    }

    fn until(&self, patience: Duration) -> Until {
        match self.process.follows() {
            true => Until::Time(self.time.now_ms() + patience.as_millis() as u64),
            false => Until::Wall(Instant::now() + patience),
        }
    }

    /// Waits for a line that contains all these words.
    ///
    /// # Panics
    /// Panics if there is no such line within [`PATIENCE`].
    pub fn wait(&mut self, words: &[&str]) -> String {
        match self.wait_for(PATIENCE, words) {
            Some(line) => line,
            None => {
                self.process.kill();
                // A program that has ended by itself was not killed, and its own status says why.
                let status = self.process.wait();
                panic!("no line with {words:?}; {status}; there were\n{}", self.seen.join("\n"));
            }
        }
    }

    /// Like [`Self::wait`] with another limit, except that it returns `None` if there is no such line.
    pub fn wait_for(&mut self, patience: Duration, words: &[&str]) -> Option<String> {
        let until = self.until(patience);
        loop {
            let line = self.await_next(&until)?;
            if words.iter().all(|word| line.contains(word)) {
                return Some(line);
            }
        }
    }

    /// Reads all output printed so far.
    pub fn catch_up(&mut self) {
        while self.next().is_some() {}
    }

    /// Returns whether the last state printed by `run --json` is armed.
    pub fn is_armed(&mut self) -> bool {
        self.catch_up();
        self.seen
            .iter()
            .rev()
            .find(|line| line.contains("\"event\":\"state\""))
            .is_some_and(|l| l.contains("armed"))
    }

    /// Types a line.
    pub fn type_line(&self, line: &str) {
        if let Some(stdin) = &mut *self.stdin.borrow_mut() {
            let _ = writeln!(stdin, "{line}").and_then(|()| stdin.flush());
        }
    }

    /// Presses Ctrl-C.
    pub fn interrupt(&self) {
        self.signal("-INT");
    }

    /// Sends a signal.
    pub fn signal(&self, name: &str) {
        self.process.signal(name);
    }

    /// Waits for the end of the program, and returns its exit status and its complete output.
    ///
    /// # Panics
    /// Panics if the program does not end.
    pub fn end(mut self) -> (ExitStatus, String) {
        *self.stdin.borrow_mut() = None;
        let until = self.until(PATIENCE);
        while self.await_next(&until).is_some() {}
        if self.outputs.iter().any(|output| output.from.is_some()) {
            self.process.kill();
            panic!("it does not end; it printed\n{}", self.seen.join("\n"));
        }
        (self.process.wait(), self.seen.join("\n"))
    }
}

enum Until {
    Time(u64),
    Wall(Instant),
}

impl Until {
    fn is_over(&self, time: &Time) -> bool {
        match self {
            Until::Time(ms) => time.now_ms() >= *ms,
            Until::Wall(moment) => Instant::now() >= *moment,
        }
    }
}
