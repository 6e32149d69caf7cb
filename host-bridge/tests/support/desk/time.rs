//! One time for boards, wires and programs, in steps of a millisecond.
//!
//! A step is over when every board has run for it and every thread of every program waits for a later time (the
//! program's side is `test_clock.rs`, feature `test-clock`). Between two steps nothing moves, however long the test
//! thinks: a busy machine makes a test slow, and nothing in it late.

use std::cell::{Cell, RefCell};
use std::io::{ErrorKind, Read as _, Write as _};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus};
use std::rc::{Rc, Weak};
use std::time::{Duration, Instant};

use super::port::alone;

/// By the wall clock, for one step or one start of a program. Nothing takes nearly so long even on a busy machine; a
/// hang must not stop the tests.
const PATIENCE: Duration = Duration::from_secs(240);
/// A [`Time::keep_pace`] that was kept waiting makes up for this much and forgets the rest.
const MADE_UP: Duration = Duration::from_millis(20);

/// Something that runs in steps.
pub trait Turn {
    /// Runs until this time.
    fn run(&mut self, now_ms: u64);
    /// Sends and receives the bytes of the step.
    fn exchange(&mut self);
}

/// A test's time. Clones are the same time.
#[derive(Clone)]
pub struct Time(Rc<Inner>);

struct Inner {
    folder: PathBuf,
    now_ms: Cell<u64>,
    started: Cell<u32>,
    turns: RefCell<Vec<Weak<RefCell<dyn Turn>>>>,
    programs: RefCell<Vec<Weak<Process>>>,
    /// When, by the wall clock, the next step may be over.
    due: Cell<Option<Instant>>,
}

impl Time {
    /// Begins at 0. What it needs of files lies in this folder.
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

    /// From now on no faster than the wall clock, for programs that keep time by that clock only. Slower on a busy machine.
    pub fn keep_pace(&self) {
        self.0.due.set(Some(Instant::now()));
    }

    /// Milliseconds so far.
    pub fn now_ms(&self) -> u64 {
        self.0.now_ms.get()
    }

    /// Lets this much time pass.
    pub fn pass(&self, time: Duration) {
        (0..time.as_millis()).for_each(|_| self.step());
    }

    /// The laptop sleeps for this long and its boards do not: programs get no time meanwhile, and all of it at once with the
    /// next step, as the machine's own clock gives it to them when it wakes.
    pub fn suspend(&self, time: Duration) {
        (0..time.as_millis()).for_each(|_| self.turn(&[]));
        self.step();
    }

    /// Lets a millisecond pass.
    ///
    /// # Panics
    /// If a program hangs.
    pub fn step(&self) {
        let programs: Vec<_> = self.0.programs.borrow().iter().filter_map(Weak::upgrade).collect();
        self.turn(&programs);
        if let Some(due) = self.0.due.get() {
            let (due, now) = (due + Duration::from_millis(1), Instant::now());
            std::thread::sleep(due.saturating_duration_since(now));
            self.0.due.set(Some(due.max(now - MADE_UP)));
        }
    }

    /// A millisecond of the boards, the wires and these programs.
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

    /// From now on this runs in steps, as long as it exists.
    pub fn add(&self, turn: Weak<RefCell<dyn Turn>>) {
        self.0.turns.borrow_mut().push(turn);
    }

    /// Starts a program that takes its time from here. Time stands still until it has begun to.
    ///
    /// # Panics
    /// If it does not start.
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

/// How a program takes part.
enum Follows {
    /// It is starting.
    NotYet(UnixListener),
    Time(UnixStream),
    /// It ended, or keeps time by the wall clock.
    Nothing,
}

/// A running program, which is ended when this is dropped.
pub struct Process {
    child: RefCell<Child>,
    follows: RefCell<Follows>,
}

impl Process {
    /// Starts a program that keeps time by the wall clock.
    ///
    /// # Panics
    /// If it does not start.
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

    /// The process, for its pipes and the like.
    pub fn child(&self) -> std::cell::RefMut<'_, Child> {
        self.child.borrow_mut()
    }

    /// Its process id.
    pub fn id(&self) -> u32 {
        self.child.borrow().id()
    }

    /// Does it take its time from the test's, or will it?
    pub fn follows(&self) -> bool {
        !matches!(*self.follows.borrow(), Follows::Nothing)
    }

    /// Sends a signal, such as `-INT` (Ctrl-C).
    pub fn signal(&self, name: &str) {
        let _alone = alone();
        let _ = Command::new("kill").args([name, &self.id().to_string()]).status();
    }

    /// Ends it.
    pub fn kill(&self) {
        let _ = self.child.borrow_mut().kill();
    }

    /// How it ended. Waits for the end.
    pub fn wait(&self) -> ExitStatus {
        self.child.borrow_mut().wait().expect("it ends")
    }

    fn has_ended(&self) -> bool {
        self.child.borrow_mut().try_wait().is_ok_and(|status| status.is_some())
    }

    /// Waits for it to take part; `now_ms` is where it begins.
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
        match socket.read(&mut [0]) {
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
