//! The end of the program is a stop, however it comes about: a signal, a terminal that is gone, a panic in any
//! thread.
//!
//! ```text
//! INT, TERM, HUP, QUIT ─┐
//! terminal hung up     ─┼─► the session's quit flag ─► base and arm are halted ─► the program ends
//! panic in any thread  ─┘                           └─► after 0.9 s without an end: the terminal is given back,
//!                                                       and the process exits
//! ```
//! Where SIGHUP was ignored from the start (`nohup`) it stays ignored; a terminal that hangs up is the end of input
//! all the same.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crossterm::terminal::disable_raw_mode;
use host_links::links::{Clock as _, SystemClock};

/// A program that was told to end and has not is ended after this long.
const PATIENCE_MS: u64 = 900;
/// How often that is checked.
const LOOK: Duration = Duration::from_millis(10);

/// Leaves the alternate screen and shows the cursor: what the live view changed.
const RESTORE: &[u8] = b"\x1b[?1049l\x1b[?25h\r\n";

/// The exit code of a session that was told to end and had to be ended.
const FORCED: i32 = 1;

/// See the module. Dropping it changes nothing: the program is about to end.
pub struct Ending {
    panicked: Arc<Mutex<Option<String>>>,
}

impl Ending {
    /// From now on every such end sets `quit`. `screen`: the live view has the terminal.
    ///
    /// # Errors
    /// The system does not let signals be caught.
    pub fn watch(quit: &Arc<AtomicBool>, screen: bool) -> io::Result<Self> {
        // Set by an end from outside only: a session that the operator ends may take its time.
        let told = Arc::new(AtomicBool::new(false));
        for signal in system::signals() {
            signal_hook::flag::register(signal, Arc::clone(quit))?;
            signal_hook::flag::register(signal, Arc::clone(&told))?;
        }
        let panicked = Arc::new(Mutex::new(None));
        watch_panics(quit, &told, &panicked, screen);
        let quit = Arc::clone(quit);
        let clock = SystemClock::start();
        let waiter = clock.waiter();
        std::thread::Builder::new().name("ending".to_owned()).spawn(move || {
            let mut since_ms = None;
            loop {
                waiter.sleep(LOOK);
                if screen && system::terminal_is_gone() {
                    told.store(true, Ordering::SeqCst);
                    quit.store(true, Ordering::SeqCst);
                }
                let now_ms = clock.now_ms();
                if told.load(Ordering::SeqCst) && now_ms - *since_ms.get_or_insert(now_ms) >= PATIENCE_MS {
                    if screen {
                        give_terminal_back();
                    }
                    std::process::exit(FORCED);
                }
            }
        })?;
        Ok(Ending { panicked })
    }

    /// The message of a thread that panicked, if one did.
    pub fn panicked(&self) -> Option<String> {
        self.panicked.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

fn watch_panics(
    quit: &Arc<AtomicBool>,
    told: &Arc<AtomicBool>,
    panicked: &Arc<Mutex<Option<String>>>,
    screen: bool,
) {
    let (quit, told, panicked) = (Arc::clone(quit), Arc::clone(told), Arc::clone(panicked));
    let before = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        // The halt comes first, the message later.
        quit.store(true, Ordering::SeqCst);
        told.store(true, Ordering::SeqCst);
        let thread = std::thread::current().name().unwrap_or("a thread").to_owned();
        *panicked.lock().unwrap_or_else(PoisonError::into_inner) = Some(format!("{thread}: {info}"));
        if screen {
            give_terminal_back();
        }
        before(info);
    }));
}

/// Gives the terminal back as it was, as far as that can be done without waiting for it.
fn give_terminal_back() {
    let _ = disable_raw_mode();
    system::write_at_once(RESTORE);
}

#[cfg(unix)]
mod system {
    use std::io;

    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM};

    const AT_ONCE: Timespec = Timespec { tv_sec: 0, tv_nsec: 0 };

    /// What tells a program to end.
    pub fn signals() -> impl Iterator<Item = i32> {
        [SIGINT, SIGTERM, SIGQUIT, SIGHUP].into_iter().filter(|s| *s != SIGHUP || !hangups_are_ignored())
    }

    /// Was this program started with SIGHUP ignored? (`std` cannot say; Linux's /proc can.)
    fn hangups_are_ignored() -> bool {
        let Ok(status) = std::fs::read_to_string("/proc/self/status") else { return false };
        let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
        mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 != 0)
    }

    /// Has the terminal behind the standard input hung up? Reading from it would never end.
    pub fn terminal_is_gone() -> bool {
        let stdin = io::stdin();
        let mut look = [PollFd::new(&stdin, PollFlags::empty())];
        let gone = PollFlags::HUP | PollFlags::ERR | PollFlags::NVAL;
        poll(&mut look, Some(&AT_ONCE)).is_ok() && look[0].revents().intersects(gone)
    }

    /// Writes to the terminal if that is possible without waiting.
    pub fn write_at_once(bytes: &[u8]) {
        let stdout = io::stdout();
        let mut look = [PollFd::new(&stdout, PollFlags::OUT)];
        if poll(&mut look, Some(&AT_ONCE)).is_ok() && look[0].revents().contains(PollFlags::OUT) {
            let _ = rustix::io::write(&stdout, bytes);
        }
    }
}

/// Compiled, and never run by us: no machine with Windows was at hand.
#[cfg(not(unix))]
mod system {
    use std::io::{self, Write as _};

    use signal_hook::consts::{SIGINT, SIGTERM};

    /// What tells a program to end.
    pub fn signals() -> impl Iterator<Item = i32> {
        [SIGINT, SIGTERM].into_iter()
    }

    /// A console that is closed ends its programs itself.
    pub fn terminal_is_gone() -> bool {
        false
    }

    /// Writes to the console, which cannot be asked whether it would wait.
    pub fn write_at_once(bytes: &[u8]) {
        let mut stdout = io::stdout();
        let _ = stdout.write_all(bytes).and_then(|()| stdout.flush());
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;
    use std::process::Command;

    const CHILD: &str = "BIMANUAL_TEST_ENDING";

    /// Run by the test below in a process of its own, since the whole process is watched.
    #[test]
    fn child() {
        let Ok(how) = std::env::var(CHILD) else { return };
        let quit = Arc::new(AtomicBool::new(false));
        let ending = Ending::watch(&quit, false).unwrap();
        let began = Instant::now();
        let _ =
            std::thread::Builder::new().name("some reader".to_owned()).spawn(|| panic!("it broke")).unwrap();
        while !quit.load(Ordering::SeqCst) {
            assert!(began.elapsed() < Duration::from_secs(20));
            std::thread::yield_now();
        }
        let told =
            ending.panicked().is_none_or(|text| text.contains("some reader") && text.contains("it broke"));
        println!("row: a panic in a thread: the halt | 1 | {} ms | 20 ms", began.elapsed().as_millis());
        match how.as_str() {
            "ends" => std::process::exit(if told { 42 } else { 43 }),
            // A session that does not end by itself is ended.
            _ => std::thread::sleep(Duration::from_secs(60)),
        }
    }

    #[test]
    fn a_panic_in_any_thread_halts_and_a_program_that_hangs_then_is_ended() {
        for (how, code) in [("ends", 42), ("hangs", FORCED)] {
            let began = Instant::now();
            let mut child = Command::new(std::env::current_exe().unwrap());
            let done =
                child.args(["--exact", "ending::tests::child", "--nocapture"]).env(CHILD, how).output();
            let done = done.unwrap();
            assert_eq!(done.status.code(), Some(code), "{}", String::from_utf8_lossy(&done.stderr));
            assert!(began.elapsed() < Duration::from_secs(20), "{how}");
            let said = String::from_utf8_lossy(&done.stdout);
            said.lines().filter(|line| line.contains("row:")).for_each(|line| println!("{line}"));
        }
    }
}
