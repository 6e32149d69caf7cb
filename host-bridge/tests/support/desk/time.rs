//! A common time for boards, cables and programs, in steps of a millisecond.
//!
//! A step ends when every board has run for a millisecond,
//! and every thread of every program waits for a later time.
//! The programs' part is `test_clock.rs` (feature `test-clock`).
//! Between two steps, the time stands still. A busy machine slows a test down, but causes no delay within it.

use std::cell::{Cell, RefCell};
use std::io::{ErrorKind, Read as _, Write as _};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus};
use std::rc::{Rc, Weak};
use std::time::{Duration, Instant};

use super::port::alone;

/// Limit in wall-clock time for one step, or for the start of a program.
/// The limit is much longer than a busy machine needs, and only prevents a test from hanging forever.
const PATIENCE: Duration = Duration::from_secs(240);
/// Maximum delay that [`Time::keep_pace`] catches up with. It ignores longer delays.
const MADE_UP: Duration = Duration::from_millis(20);

/// A component that runs in steps.
pub trait Turn {
    /// Runs until this time.
    fn run(&mut self, now_ms: u64);
    /// Sends and receives the bytes of this step.
    fn exchange(&mut self);
}

/// The time of a test. All clones share the same time.
#[derive(Clone)]
pub struct Time(Rc<Inner>);

struct Inner {
    folder: PathBuf,
    now_ms: Cell<u64>,
    started: Cell<u32>,
    turns: RefCell<Vec<Weak<RefCell<dyn Turn>>>>,
    programs: RefCell<Vec<Weak<Process>>>,
    /// Earliest wall-clock time for the end of the next step.
    due: Cell<Option<Instant>>,
}

impl Time {
    /// Starts the time at 0. Its files are stored in this folder.
    pub fn start(folder: &Path) -> Self {
        Self(Rc::new(Inner {
            folder: folder.to_path_buf(),
            now_ms: Cell::new(0),
            started: Cell::new(0),
            turns: RefCell::default(),
            programs: RefCell::default(),
            due: Cell::new(None),
        }))
    }

    /// Limits the speed to that of the wall clock, for programs that use only that clock. A busy machine may be slower.
    pub fn keep_pace(&self) {
        self.0.due.set(Some(Instant::now()));
    }

    /// Returns the milliseconds so far.
    pub fn now_ms(&self) -> u64 {
        self.0.now_ms.get()
    }

    /// Advances the time by this duration.
    pub fn pass(&self, time: Duration) {
        (0..time.as_millis()).for_each(|_| self.step());
    }

    /// Suspends the laptop for this duration while its boards continue.
    /// During the suspension, the programs' time does not advance. At the next step it jumps, as after a real suspend.
    pub fn suspend(&self, time: Duration) {
        (0..time.as_millis()).for_each(|_| self.turn(&[]));
        self.step();
    }

    /// Advances the time by one millisecond.
    ///
    /// # Panics
    /// Panics if a program hangs.
    pub fn step(&self) {
        let programs: Vec<_> = self.0.programs.borrow().iter().filter_map(Weak::upgrade).collect();
        self.turn(&programs);
        if let Some(due) = self.0.due.get() {
            let (due, now) = (due + Duration::from_millis(1), Instant::now());
            std::thread::sleep(due.saturating_duration_since(now));
            self.0.due.set(Some(due.max(now - MADE_UP)));
        }
    }

    /// Runs the boards, the cables and these programs for one millisecond.
    fn turn(&self, programs: &[Rc<Process>]) {
        let now_ms = self.now_ms() + 1;
        programs.iter().for_each(|program| program.join(self.now_ms()));
        programs.iter().for_each(|program| program.tell(now_ms));
        let turns: Vec<_> = self.0.turns.borrow().iter().filter_map(Weak::upgrade).collect();
        turns.iter().for_each(|turn| turn.borrow_mut().run(now_ms));
        programs.iter().for_each(|program| program.await_done());
        turns.iter().for_each(|turn| turn.borrow_mut().exchange());
        self.0.now_ms.set(now_ms);
    }

    /// Adds a component, which then runs in steps until it is dropped.
    pub fn add(&self, turn: Weak<RefCell<dyn Turn>>) {
        self.0.turns.borrow_mut().push(turn);
    }

    /// Starts a program that uses this time. The time stands still until the program has joined.
    ///
    /// # Panics
    /// Panics if the program does not start.
    pub fn spawn(&self, command: &mut Command) -> Rc<Process> {
        let number = self.0.started.get();
        self.0.started.set(number + 1);
        let path = self.0.folder.join(format!("time-{number}"));
        let _ = std::fs::remove_file(&path);
        let listener = UnixListener::bind(&path).expect("a socket");
        listener.set_nonblocking(true).expect("a socket");
        command.env("BIMANUAL_TEST_CLOCK", &path);
        let program = Rc::new(Process::spawn(command, Follows::NotYet(listener)));
        self.0.programs.borrow_mut().push(Rc::downgrade(&program));
        program
    }
}

/// The way in which a program takes part in the test's time.
enum Follows {
    /// The program is starting.
    NotYet(UnixListener),
    Time(UnixStream),
    /// The program has ended or uses wall-clock time.
    Nothing,
}

/// A running program, which is killed when this is dropped.
pub struct Process {
    child: RefCell<Child>,
    follows: RefCell<Follows>,
}

impl Process {
    /// Starts a program that uses wall-clock time.
    ///
    /// # Panics
    /// Panics if the program does not start.
    pub fn on_its_own(command: &mut Command) -> Rc<Self> {
        Rc::new(Self::spawn(command, Follows::Nothing))
    }

    fn spawn(command: &mut Command, follows: Follows) -> Self {
        let child = {
            let _alone = alone();
            command.spawn().unwrap_or_else(|error| panic!("{command:?} does not start: {error}"))
        };
        Self { child: RefCell::new(child), follows: RefCell::new(follows) }
    }

    /// Returns the child process, for example to access its pipes.
    pub fn child(&self) -> std::cell::RefMut<'_, Child> {
        self.child.borrow_mut()
    }

    /// Returns the process id.
    pub fn id(&self) -> u32 {
        self.child.borrow().id()
    }

    /// Returns whether the program uses the test's time or will join it.
    pub fn follows(&self) -> bool {
        !matches!(*self.follows.borrow(), Follows::Nothing)
    }

    /// Sends a signal, such as `-INT` (Ctrl-C).
    pub fn signal(&self, name: &str) {
        let _alone = alone();
        let _ = Command::new("kill").args([name, &self.id().to_string()]).status();
    }

    /// Kills the program.
    pub fn kill(&self) {
        let _ = self.child.borrow_mut().kill();
    }

    /// Waits for the end and returns the exit status.
    pub fn wait(&self) -> ExitStatus {
        self.child.borrow_mut().wait().expect("it ends")
    }

    fn has_ended(&self) -> bool {
        self.child.borrow_mut().try_wait().is_ok_and(|status| status.is_some())
    }

    /// Waits until the program joins, at the time `now_ms`.
    fn join(&self, now_ms: u64) {
        let mut follows = self.follows.borrow_mut();
        let Follows::NotYet(listener) = &*follows else { return };
        let until = Instant::now() + PATIENCE;
        let joined = loop {
            match listener.accept() {
                Ok((mut socket, _)) => {
                    socket.set_nonblocking(false).expect("a socket");
                    socket.set_read_timeout(Some(PATIENCE)).expect("a socket");
                    let _ = socket.write_all(&now_ms.to_le_bytes());
                    break Follows::Time(socket);
                }
                Err(_) if self.has_ended() => break Follows::Nothing,
                Err(_) => std::thread::sleep(Duration::from_micros(300)),
            }
            assert!(Instant::now() < until, "a program neither asks for the time nor ends");
        };
        *follows = joined;
    }

    fn tell(&self, now_ms: u64) {
        let mut follows = self.follows.borrow_mut();
        if let Follows::Time(socket) = &mut *follows
            && socket.write_all(&now_ms.to_le_bytes()).is_err()
        {
            *follows = Follows::Nothing;
        }
    }

    fn await_done(&self) {
        let mut follows = self.follows.borrow_mut();
        let Follows::Time(socket) = &mut *follows else { return };
        // A socket with a time limit reports an interruption when this process is stopped and continued (signal(7)).
        let done = loop {
            match socket.read(&mut [0]) {
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                done => break done,
            }
        };
        match done {
            Ok(1..) => {}
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                let _ = self.child.borrow_mut().kill();
                panic!("a program hangs: one of its threads does not come to wait for a later time");
            }
            _ => *follows = Follows::Nothing,
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let child = self.child.get_mut();
        let _ = child.kill();
        let _ = child.wait();
    }
}
