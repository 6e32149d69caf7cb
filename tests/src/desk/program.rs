//! The programs as a user runs them: what is typed, and what comes out line by line.

use std::io::{BufRead as _, BufReader, Read, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
use std::sync::OnceLock;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

use super::port::alone;

/// Nothing here takes nearly so long, even on a busy machine; a hang must not stop the tests.
pub const PATIENCE: Duration = Duration::from_secs(240);

/// The folder of `host-bridge` and `models`, built as the tests are. `BIMANUAL_PROGRAMS` names one in which they lie
/// already, as `cargo xtask test` has built them.
///
/// # Panics
/// Where they do not build; the reason is on the terminal.
pub fn folder() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        if let Some(folder) = std::env::var_os("BIMANUAL_PROGRAMS") {
            return folder.into();
        }
        let exe = std::env::current_exe().expect("a path");
        let debug = exe.ancestors().nth(2).expect("target/debug/deps/test");
        let mut build = Command::new("cargo");
        build.current_dir(env!("CARGO_MANIFEST_DIR")).args(["build", "-q", "--locked"]);
        build.args(["-p", "host-bridge", "-p", "models", "--bins"]);
        if cfg!(feature = "ble") {
            build.args(["--features", "host-bridge/ble"]);
        }
        build.arg("--target-dir").arg(debug.parent().expect("target"));
        let child = {
            let _alone = alone();
            build.spawn()
        };
        let status = child.and_then(|mut child| child.wait()).expect("cargo starts");
        assert!(status.success(), "host-bridge and models do not build");
        debug.to_path_buf()
    })
}

/// A folder for one test, gone with it.
pub struct Desk {
    path: PathBuf,
}

impl Desk {
    /// A new and empty one.
    ///
    /// # Panics
    /// Where it cannot be made.
    pub fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("bimanual-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).expect("a folder");
        Self { path }
    }

    /// A path in it.
    pub fn path(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// The same as text.
    pub fn text(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }
}

impl Drop for Desk {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.path);
    }
}

/// A program under way.
pub struct Running {
    child: Child,
    stdin: Option<ChildStdin>,
    lines: Receiver<String>,
    /// What it has printed so far, on both outputs.
    pub seen: Vec<String>,
}

/// Starts `host-bridge` with these arguments.
pub fn bridge(args: &[&str]) -> Running {
    println!("$ host-bridge {}", args.join(" "));
    let mut command = Command::new(folder().join("host-bridge"));
    command.args(args);
    start(command)
}

/// Runs `host-bridge` to its end.
pub fn run(args: &[&str]) -> (ExitStatus, String) {
    bridge(args).end()
}

/// Starts a command; its output is printed as it comes.
///
/// # Panics
/// Where it does not start.
pub fn start(mut command: Command) -> Running {
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = {
        let _alone = alone();
        command.spawn().expect("the program starts")
    };
    let (sender, lines) = channel();
    read(child.stdout.take().expect("a pipe"), sender.clone());
    read(child.stderr.take().expect("a pipe"), sender);
    let stdin = child.stdin.take();
    Running { child, stdin, lines, seen: Vec::new() }
}

/// Lines as they end; what waits for an answer on its line (a question) counts as one, too.
fn read(out: impl Read + Send + 'static, sender: Sender<String>) {
    std::thread::spawn(move || {
        let mut out = BufReader::new(out);
        let mut line = Vec::new();
        loop {
            let chunk = match out.fill_buf() {
                Ok([]) | Err(_) => break,
                Ok(chunk) => chunk,
            };
            let (mut used, mut whole) = (0, false);
            for &byte in chunk {
                used += 1;
                whole = byte == b'\n';
                if whole {
                    break;
                }
                line.push(byte);
            }
            out.consume(used);
            let asks = line.ends_with(b"press Enter ");
            if (whole || asks) && sender.send(String::from_utf8_lossy(&line).into_owned()).is_err() {
                break;
            }
            if whole || asks {
                line.clear();
            }
        }
        if !line.is_empty() {
            let _ = sender.send(String::from_utf8_lossy(&line).into_owned());
        }
    });
}

impl Running {
    fn next(&mut self, until: Instant) -> Option<String> {
        let line = self.lines.recv_timeout(until.saturating_duration_since(Instant::now())).ok()?;
        println!("  {line}");
        self.seen.push(line.clone());
        Some(line)
    }

    /// Waits for a line with all these words.
    ///
    /// # Panics
    /// Where none comes in [`PATIENCE`].
    pub fn wait(&mut self, words: &[&str]) -> String {
        match self.wait_for(PATIENCE, words) {
            Some(line) => line,
            None => {
                let _ = self.child.kill();
                panic!("no line with {words:?}; there were\n{}", self.seen.join("\n"));
            }
        }
    }

    /// The same for so long; none if none came.
    pub fn wait_for(&mut self, patience: Duration, words: &[&str]) -> Option<String> {
        let until = Instant::now() + patience;
        loop {
            let line = self.next(until)?;
            if words.iter().all(|word| line.contains(word)) {
                return Some(line);
            }
        }
    }

    /// Takes what has been printed up to now.
    pub fn catch_up(&mut self) {
        while self.next(Instant::now()).is_some() {}
    }

    /// The last state that `run --json` told.
    pub fn is_armed(&mut self) -> bool {
        self.catch_up();
        self.seen
            .iter()
            .rev()
            .find(|line| line.contains("\"event\":\"state\""))
            .is_some_and(|l| l.contains("armed"))
    }

    /// Types a line.
    pub fn type_line(&mut self, line: &str) {
        if let Some(stdin) = &mut self.stdin {
            let _ = writeln!(stdin, "{line}").and_then(|()| stdin.flush());
        }
    }

    /// Presses Ctrl-C.
    pub fn interrupt(&self) {
        let _alone = alone();
        let _ = Command::new("kill").args(["-INT", &self.child.id().to_string()]).status();
    }

    /// Waits for the end; how it ended, and all it printed.
    ///
    /// # Panics
    /// Where it does not end.
    pub fn end(mut self) -> (ExitStatus, String) {
        self.stdin = None;
        let until = Instant::now() + PATIENCE;
        while self.next(until).is_some() {}
        if self.child.try_wait().expect("it can be asked").is_none() && Instant::now() >= until {
            let _ = self.child.kill();
            panic!("it does not end; it printed\n{}", self.seen.join("\n"));
        }
        (self.child.wait().expect("it ends"), self.seen.join("\n"))
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
