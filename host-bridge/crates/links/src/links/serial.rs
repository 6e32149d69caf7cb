//! A serial port with a thread that opens, reads and reopens it.

use std::io::{ErrorKind, Read as _, Write as _};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::JoinHandle;
use std::time::Duration;

use serialport::SerialPort;
use shared_proto::frame::DELIMITER;
use shared_words::Hand;

use super::{Clock, EventSender, LinkEvent, News, Waiter, Waker};

/// First delay before a port is reopened. The delay doubles each time, up to [`LAST_PAUSE`].
const FIRST_PAUSE: Duration = Duration::from_millis(100);
const LAST_PAUSE: Duration = Duration::from_secs(2);

/// Maximum time for which a blocked write may delay its caller.
const WRITE_PATIENCE: Duration = Duration::from_millis(20);
/// Interval at which the reading thread checks whether it should end. Received bytes wake it immediately.
const READ_PATIENCE: Duration = Duration::from_millis(50);

/// After the port is opened, a Nano in reset is silent from this time on until its program runs.
/// Data that arrives later therefore does not come from a bootloader, and the program may send.
const BOOTLOADER_SILENT_MS: u64 = 300;

/// How a port is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SerialSettings {
    /// Speed of the line. A board on native USB ignores the speed.
    pub baud: u32,
    /// Nothing is sent for this long after the port was opened, unless the board sends first.
    pub settle_ms: u64,
    /// Whether boards over Bluetooth may be unbonded.
    pub allow_unbonded: bool,
    /// Over Bluetooth, only boards for this hand are taken; `None` takes any.
    pub hand: Option<Hand>,
}

impl Default for SerialSettings {
    /// The boards' 115200 baud, and the maximum waiting time of an old Nano bootloader.
    fn default() -> Self {
        SerialSettings { baud: 115_200, settle_ms: 2500, allow_unbonded: false, hand: None }
    }
}

/// The sending side, and the known state of the board.
#[derive(Default)]
struct Sending {
    port: Option<Box<dyn SerialPort>>,
    opened_ms: u64,
    /// Whether something other than a bootloader has sent bytes.
    awake: bool,
    /// Whether the last write was incomplete, so that the next one must first terminate that frame.
    cut: bool,
}

/// A port with its thread. Dropping it closes the port.
pub struct SerialLink {
    port: String,
    settings: SerialSettings,
    clock: Arc<dyn Clock>,
    line: Arc<Mutex<Sending>>,
    ended: Arc<AtomicBool>,
    waker: Waker,
    thread: Option<JoinHandle<()>>,
}

impl SerialLink {
    /// Starts the thread, which reports everything to `events`, marked with `link`.
    pub fn start<I: Copy + Send + 'static>(
        link: I,
        port: &str,
        settings: SerialSettings,
        clock: Arc<dyn Clock>,
        events: EventSender<I>,
    ) -> Self {
        let line = Arc::new(Mutex::new(Sending::default()));
        let ended = Arc::new(AtomicBool::new(false));
        let waiter = clock.waiter();
        let waker = waiter.waker();
        let reader = Reader {
            link,
            waiter,
            port: port.to_owned(),
            settings,
            clock: Arc::clone(&clock),
            line: Arc::clone(&line),
            ended: Arc::clone(&ended),
            events,
        };
        let thread = Some(std::thread::spawn(move || reader.run()));
        SerialLink { port: port.to_owned(), settings, clock, line, ended, waker, thread }
    }

    /// The port's name.
    pub fn port(&self) -> &str {
        &self.port
    }

    /// Returns whether bytes can be sent now.
    /// This is not possible while the port is closed, or soon after a reset.
    pub fn is_ready(&self) -> bool {
        let line = lock(&self.line);
        let waited_ms = self.clock.now_ms().saturating_sub(line.opened_ms);
        line.port.is_some() && (line.awake || waited_ms >= self.settings.settle_ms)
    }

    /// Sends one frame. Returns false if it cannot be sent now; nothing is queued for later.
    pub fn send(&self, frame: &[u8]) -> bool {
        if !self.is_ready() {
            return false;
        }
        let mut line = lock(&self.line);
        let cut = line.cut;
        let Some(port) = &mut line.port else { return false };
        let sent = (!cut || port.write_all(&[DELIMITER]).is_ok()) && port.write_all(frame).is_ok();
        line.cut = !sent;
        sent
    }
}

impl Drop for SerialLink {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        self.waker.wake();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// A panic in another thread must not make a port unusable.
fn lock(line: &Mutex<Sending>) -> MutexGuard<'_, Sending> {
    line.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

struct Reader<I> {
    link: I,
    waiter: Waiter,
    port: String,
    settings: SerialSettings,
    clock: Arc<dyn Clock>,
    line: Arc<Mutex<Sending>>,
    ended: Arc<AtomicBool>,
    events: EventSender<I>,
}

impl<I: Copy> Reader<I> {
    fn run(&self) {
        let mut pause = FIRST_PAUSE;
        let mut said = None;
        while !self.is_over() {
            let problem = match self.open() {
                Err(problem) => problem,
                Ok(port) => {
                    said = None;
                    self.tell(News::Opened);
                    let (problem, heard) = self.read(port);
                    lock(&self.line).port = None;
                    if heard {
                        pause = FIRST_PAUSE;
                    }
                    problem
                }
            };
            if said.as_ref() != Some(&problem) {
                self.tell(News::Closed(problem.clone()));
                said = Some(problem);
            }
            self.sleep(pause);
            pause = (pause * 2).min(LAST_PAUSE);
        }
    }

    fn is_over(&self) -> bool {
        self.ended.load(Ordering::Relaxed)
    }

    fn sleep(&self, pause: Duration) {
        let step = Duration::from_millis(20);
        let mut left = pause;
        while !self.is_over() && !left.is_zero() {
            self.waiter.sleep(step.min(left));
            left = left.saturating_sub(step);
        }
    }

    fn tell(&self, news: News) {
        // If no thread receives events any more, the program is about to end.
        self.events.send(LinkEvent { link: self.link, at_ms: self.clock.now_ms(), news });
    }

    fn open(&self) -> Result<Box<dyn SerialPort>, String> {
        let explain = |error: serialport::Error| explain(&self.port, &error);
        let patience = self.waiter.patience(READ_PATIENCE);
        let port =
            serialport::new(&self.port, self.settings.baud).timeout(patience).open().map_err(explain)?;
        let mut writer = port.try_clone().map_err(explain)?;
        writer.set_timeout(WRITE_PATIENCE).map_err(explain)?;
        // Data that waited in the port's buffer is outdated.
        port.clear(serialport::ClearBuffer::Input).map_err(explain)?;
        *lock(&self.line) =
            Sending { port: Some(writer), opened_ms: self.clock.now_ms(), awake: false, cut: false };
        Ok(port)
    }

    /// Reads until the port fails. Returns the reason, and whether any data arrived.
    fn read(&self, mut port: Box<dyn SerialPort>) -> (String, bool) {
        let opened_ms = self.clock.now_ms();
        let mut buffer = [0; 1024];
        let mut heard = false;
        while !self.is_over() {
            match port.read(&mut buffer) {
                Ok(0) => return (gone(&self.port), heard),
                Ok(count) => {
                    if !heard || !lock(&self.line).awake {
                        heard = true;
                        let passed_ms = self.clock.now_ms().saturating_sub(opened_ms);
                        lock(&self.line).awake = passed_ms > BOOTLOADER_SILENT_MS;
                    }
                    self.tell(News::Bytes(buffer[..count].to_vec()));
                }
                Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => {
                    self.waiter.pause();
                }
                Err(_) => return (gone(&self.port), heard),
            }
        }
        (gone(&self.port), heard)
    }
}

fn gone(port: &str) -> String {
    format!("{port}: the board is gone; plug it in again, the link comes back by itself")
}

/// Explains why a port cannot be opened, with a remedy.
fn explain(port: &str, error: &serialport::Error) -> String {
    use serialport::ErrorKind as K;
    let advice = match error.kind {
        K::Io(ErrorKind::NotFound) => "plug the board in; `host-bridge list` shows the ports",
        K::Io(ErrorKind::PermissionDenied) => {
            "you may not open it: `sudo usermod -aG dialout $USER` (Arch: group uucp), then log in again"
        }
        K::NoDevice | K::Io(ErrorKind::WouldBlock) => {
            "another program uses it: close the serial monitor or the other host-bridge"
        }
        _ => "is this a serial port? `host-bridge list` shows them",
    };
    format!("{port}: {}; {advice}", error.description)
}

#[cfg(test)]
mod tests {
    use super::super::SystemClock;
    use super::*;

    #[test]
    fn a_port_that_is_not_there_is_reported_once_and_takes_nothing() {
        let (sender, events) = super::super::queue();
        let clock = Arc::new(SystemClock::start());
        let link = SerialLink::start(7, "/no/such/port", SerialSettings::default(), clock, sender);
        let event = events.recv_timeout(Duration::from_secs(10)).unwrap();
        assert_eq!(event.link, 7);
        let News::Closed(text) = event.news else { panic!("{event:?}") };
        assert!(text.contains("/no/such/port") && text.contains("host-bridge list"), "{text}");
        assert!(!link.is_ready() && !link.send(&[1, 2, 0]));
        // The link retries after 100 and 200 ms without another report.
        assert!(events.recv_timeout(Duration::from_millis(400)).is_err());
    }

    #[test]
    fn every_refusal_says_what_to_do() {
        for (kind, word) in [
            (serialport::ErrorKind::Io(ErrorKind::NotFound), "plug"),
            (serialport::ErrorKind::Io(ErrorKind::PermissionDenied), "dialout"),
            (serialport::ErrorKind::NoDevice, "close"),
            (serialport::ErrorKind::Unknown, "host-bridge list"),
        ] {
            let text = explain("/dev/ttyUSB0", &serialport::Error::new(kind, "refused"));
            assert!(text.contains("/dev/ttyUSB0") && text.contains(word), "{text}");
        }
    }
}
