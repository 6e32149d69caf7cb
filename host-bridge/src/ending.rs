//! Stops the robot whenever the program ends: after a signal, a lost terminal, or a panic in any thread.
//!
//! ```text
//! INT, TERM, HUP, QUIT ─┐
//! terminal hung up     ─┼─► the session's quit flag ─► base and arm are halted ─► the program ends
//! panic in any thread  ─┘                           └─► after 0.9 s without an end: the terminal is given back,
//!                                                       and the process exits
//! ```
//! If SIGHUP was ignored from the start (`nohup`), it stays ignored.
//! A terminal that hangs up still ends the input.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crossterm::terminal::disable_raw_mode;
use host_links::links::{Clock as _, SystemClock};

/// Time between the request to end and the forced termination of the program.
const PATIENCE_MS: u64 = 900;
/// Interval of this check.
const LOOK: Duration = Duration::from_millis(10);

/// Undoes the live view's changes: leaves the alternate screen, and shows the cursor.
const RESTORE: &[u8] = b"\x1b[?1049l\x1b[?25h\r\n";

/// The exit code of a session that had to be terminated.
const FORCED: i32 = 1;

/// See the module documentation. Dropping it has no effect, because the program is about to end.
pub struct Ending {
    panicked: Arc<Mutex<Option<String>>>,
}

impl Ending {
    /// From now on, every such end of the program sets `quit`.
    /// `screen` means that the live view uses the terminal.
    ///
    /// # Errors
    /// Fails if the system does not permit signal handlers.
    pub fn watch(quit: &Arc<AtomicBool>, screen: bool) -> io::Result<Self> {
        // This flag is set only by an external end. A session that the operator ends may take its time.
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

    /// Returns the message of a thread that panicked, if there is one.
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
        // The robot is halted before the message is printed.
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

/// Restores the terminal. Steps that would have to wait for the terminal are omitted.
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

    /// Returns the signals that end a program.
    pub fn signals() -> impl Iterator<Item = i32> {
        [SIGINT, SIGTERM, SIGQUIT, SIGHUP].into_iter().filter(|s| *s != SIGHUP || !hangups_are_ignored())
    }

    /// Returns whether this program was started with SIGHUP ignored, according to Linux's /proc.
    fn hangups_are_ignored() -> bool {
        let Ok(status) = std::fs::read_to_string("/proc/self/status") else { return false };
        let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
        mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 != 0)
    }

    /// Returns whether the terminal of the standard input has hung up; reading from it would never end.
    pub fn terminal_is_gone() -> bool {
        let stdin = io::stdin();
        let mut look = [PollFd::new(&stdin, PollFlags::empty())];
        let gone = PollFlags::HUP | PollFlags::ERR | PollFlags::NVAL;
        poll(&mut look, Some(&AT_ONCE)).is_ok() && look[0].revents().intersects(gone)
    }

    /// Writes to the terminal if this is possible without waiting.
    pub fn write_at_once(bytes: &[u8]) {
        let stdout = io::stdout();
        let mut look = [PollFd::new(&stdout, PollFlags::OUT)];
        if poll(&mut look, Some(&AT_ONCE)).is_ok() && look[0].revents().contains(PollFlags::OUT) {
            let _ = rustix::io::write(&stdout, bytes);
        }
    }
}

/// This code compiles, but it was never run, because we had no Windows machine.
#[cfg(not(unix))]
mod system {
    use std::io::{self, Write as _};

    use signal_hook::consts::{SIGINT, SIGTERM};

    /// Returns the signals that end a program.
    pub fn signals() -> impl Iterator<Item = i32> {
        [SIGINT, SIGTERM].into_iter()
    }

    /// Windows itself ends the programs of a closed console.
    pub fn terminal_is_gone() -> bool {
        false
    }

    /// Writes to the console, which cannot report whether it would block.
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

    /// The test below runs this function in a separate process.
    /// The function affects the entire process.
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
            // A session that does not end by itself is terminated.
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
