//! Connects to a hand over Bluetooth Low Energy.
//! The link finds the board by its service, and reconnects.
//! Left and right hands have different services, so the link never connects to the other hand.
//!
//! btleplug handles the system's Bluetooth (on Linux, BlueZ over D-Bus).
//! The frames form two byte streams: notifications from the board, and writes to the board.
//! Writes are confirmed. A board that requires a bonded link refuses the first write.
//!
//! Only boards that are bonded with this machine are connected. The system encrypts the link before the first byte.
//! A device that merely advertises therefore cannot impersonate a board.
//! With `allow_unbonded`, any device in range could impersonate a board;
//! `Config::restriction` then limits the session.

mod advice;
mod bonds;

use std::cell::Cell;
use std::future::Future;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use btleplug::api::{
    Central as _, CentralState, Characteristic, Manager as _, Peripheral as _, ScanFilter, WriteType,
};
use btleplug::platform::{Adapter, Manager, Peripheral};
use futures::StreamExt as _;
use shared_words::{Hand, PerHand};
use tokio::sync::mpsc;
use uuid::Uuid;

use self::advice::{how_to_pair, off, trouble, unbonded};
use self::bonds::Bonds;
use super::{Clock, EventSender, LinkEvent, News, PortAbout, SerialSettings};

/// The services of a left and of a right hand, as defined in `firmware-nano33/radio/src/lib.rs`.
pub const SERVICES: PerHand<Uuid> = PerHand {
    left: Uuid::from_u128(0xb1a4_0011_6d61_4e75_a1b2_5c3d_9e7f_0a33),
    right: Uuid::from_u128(0xb1a4_0001_6d61_4e75_a1b2_5c3d_9e7f_0a33),
};
/// Frames from the board (notify).
pub const FROM_BOARD: Uuid = Uuid::from_u128(0xb1a4_0002_6d61_4e75_a1b2_5c3d_9e7f_0a33);
/// Frames to the board (write).
pub const TO_BOARD: Uuid = Uuid::from_u128(0xb1a4_0003_6d61_4e75_a1b2_5c3d_9e7f_0a33);

/// First delay before a new search for a board. The delay doubles each time, up to the maximum.
const FIRST_PAUSE: Duration = Duration::from_millis(100);
const LAST_PAUSE: Duration = Duration::from_millis(500);
/// How long one search for the board lasts.
const SEARCH: Duration = Duration::from_secs(10);
/// Maximum time for connecting and finding the service.
const CONNECT: Duration = Duration::from_secs(15);
/// Maximum time for disconnecting.
const FAREWELL: Duration = Duration::from_secs(1);
/// Interval for checking search results and the presence of the board.
const LOOK: Duration = Duration::from_millis(200);
/// Number of searches for a bonded board before an unbonded one is reported.
const LOOKS_FOR_BONDED: u32 = 5;
/// Interval at which the thread checks whether it should end.
const END: Duration = Duration::from_millis(50);
/// Maximum number of frames that wait to be sent; a slower link loses some.
const QUEUE: usize = 8;
/// Header bytes of a write, and the minimum size that every link supports.
const HEADER: u16 = 3;
const LEAST_PAYLOAD: u16 = 20;

/// Destination of frames while the board is connected.
type Outgoing = Arc<Mutex<Option<mpsc::Sender<Vec<u8>>>>>;

/// A board behind Bluetooth with its thread. Dropping it disconnects the board.
pub struct BleLink {
    port: String,
    outgoing: Outgoing,
    signal: Arc<Mutex<Option<i16>>>,
    ended: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl BleLink {
    /// Starts the thread, which reports everything to `events`, marked with `link`.
    /// `port` is `ble` for the nearest board of the settings' hand, or `ble:` with a name or an address.
    /// The board must be bonded unless `allow_unbonded` is set.
    pub fn start<I: Copy + Send + 'static>(
        link: I,
        port: &str,
        settings: SerialSettings,
        clock: Arc<dyn Clock>,
        events: EventSender<I>,
    ) -> Self {
        let outgoing = Arc::new(Mutex::new(None));
        let signal = Arc::new(Mutex::new(None));
        let ended = Arc::new(AtomicBool::new(false));
        let name = port.strip_prefix("ble:").filter(|name| !name.is_empty()).map(str::to_owned);
        let radio = Radio {
            link,
            name,
            hand: settings.hand,
            allow_unbonded: settings.allow_unbonded,
            clock,
            outgoing: Arc::clone(&outgoing),
            signal: Arc::clone(&signal),
            ended: Arc::clone(&ended),
            events,
        };
        let thread = Some(std::thread::spawn(move || radio.run()));
        BleLink { port: port.to_owned(), outgoing, signal, ended, thread }
    }

    /// `ble` or `ble:NAME`.
    pub fn port(&self) -> &str {
        &self.port
    }

    /// Strength of the signal in dBm when the board was found. The system tells none during a connection.
    pub fn signal_dbm(&self) -> Option<i16> {
        *lock(&self.signal)
    }

    /// Returns whether frames can be sent now.
    pub fn is_ready(&self) -> bool {
        lock(&self.outgoing).is_some()
    }

    /// Sends one frame. Returns false if it cannot be sent now; nothing is queued for later.
    pub fn send(&self, frame: &[u8]) -> bool {
        lock(&self.outgoing).as_ref().is_some_and(|outgoing| outgoing.try_send(frame.to_vec()).is_ok())
    }
}

impl Drop for BleLink {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// A panic in another thread must not make a link unusable.
fn lock<T>(what: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    what.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns the services of these hands.
fn services(hand: Option<Hand>) -> Vec<Uuid> {
    hand.map_or_else(|| vec![SERVICES.left, SERVICES.right], |hand| vec![SERVICES[hand]])
}

/// Searches for boards that advertise now, for the given time. Returns them as `ble:NAME`.
///
/// # Errors
/// Returns the reason why Bluetooth is not available, with a remedy.
pub fn ble_devices(patience: Duration) -> Result<Vec<PortAbout>, String> {
    runtime()?.block_on(async {
        let (_session, adapter) = adapter().await?;
        scan(&adapter, None).await?;
        tokio::time::sleep(patience).await;
        let found = candidates(&adapter, None).await?;
        let _ = adapter.stop_scan().await;
        let is_unique = |name: &str| found.iter().filter(|seen| seen.name == name).count() == 1;
        let about = |seen: &Seen| PortAbout {
            name: format!("ble:{}", if is_unique(&seen.name) { &seen.name } else { &seen.address }),
            about: match seen.rssi_dbm {
                Some(dbm) => {
                    let seconds = patience.as_secs();
                    format!("Bluetooth {}, {dbm} dBm, heard in the last {seconds} s", seen.address)
                }
                None => format!("Bluetooth {}", seen.address),
            },
            is_usb: false,
        };
        Ok(found.iter().map(about).collect())
    })
}

/// Creates a runtime for one attempt, whose end also ends all background tasks of the session.
fn runtime() -> Result<tokio::runtime::Runtime, String> {
    let built = tokio::runtime::Builder::new_current_thread().enable_all().build();
    built.map_err(|error| format!("Bluetooth: {error}; try again"))
}

struct Radio<I> {
    link: I,
    name: Option<String>,
    hand: Option<Hand>,
    allow_unbonded: bool,
    clock: Arc<dyn Clock>,
    outgoing: Outgoing,
    signal: Arc<Mutex<Option<i16>>>,
    ended: Arc<AtomicBool>,
    events: EventSender<I>,
}

impl<I: Copy> Radio<I> {
    fn run(&self) {
        let mut pause = FIRST_PAUSE;
        let mut said = None;
        while !self.is_over() {
            let was_open = Cell::new(false);
            let problem = match runtime() {
                Ok(runtime) => runtime.block_on(self.attempt(&was_open)),
                Err(problem) => problem,
            };
            *lock(&self.outgoing) = None;
            if was_open.get() {
                (said, pause) = (None, FIRST_PAUSE);
            }
            if self.is_over() {
                return;
            }
            if said.as_ref() != Some(&problem) {
                self.tell(News::Closed(problem.clone()));
                said = Some(problem);
            }
            let mut left = pause;
            while !self.is_over() && !left.is_zero() {
                std::thread::sleep(END.min(left));
                left = left.saturating_sub(END);
            }
            pause = (pause * 2).min(LAST_PAUSE);
        }
    }

    fn is_over(&self) -> bool {
        self.ended.load(Ordering::Relaxed)
    }

    async fn over(&self) -> String {
        while !self.is_over() {
            tokio::time::sleep(END).await;
        }
        "ended".to_owned()
    }

    fn tell(&self, news: News) {
        // If no thread receives events any more, the program is about to end.
        self.events.send(LinkEvent { link: self.link, at_ms: self.clock.now_ms(), news });
    }

    /// Runs one connection from search to end, and returns the reason for its end.
    async fn attempt(&self, was_open: &Cell<bool>) -> String {
        let over = async {
            let why = self.over().await;
            if was_open.get() {
                // This wait gives the connection time to detect its end and to disconnect first.
                tokio::time::sleep(FAREWELL * 2).await;
            }
            why
        };
        tokio::select! {
            why = over => why,
            result = self.connect_and_serve(was_open) => match result {
                Ok(why) | Err(why) => why,
            },
        }
    }

    async fn connect_and_serve(&self, was_open: &Cell<bool>) -> Result<String, String> {
        let (_session, adapter) = adapter().await?;
        let board = self.find(&adapter).await?;
        let name = board.name;
        *lock(&self.signal) = board.rssi_dbm;
        let (input, output) = within(CONNECT, connect(&board.peripheral, &name, self.hand)).await.unwrap_or_else(|| {
            Err(format!("{name} (Bluetooth) does not let itself be connected; is it near, and not connected elsewhere?"))
        })?;
        let peripheral = board.peripheral;
        let notes = peripheral.notifications().await.map_err(|error| trouble(&error))?;
        peripheral.subscribe(&input).await.map_err(|error| trouble(&error))?;
        let (sender, waiting) = mpsc::channel(QUEUE);
        *lock(&self.outgoing) = Some(sender);
        was_open.set(true);
        self.tell(News::Opened);
        let gone = || {
            format!(
                "{name} (Bluetooth) is gone; bring it near and switch it on, the link comes back by itself"
            )
        };
        let why = tokio::select! {
            () = self.listen(notes) => gone(),
            why = write(&peripheral, &output, waiting, &name) => why.unwrap_or_else(gone),
            () = watch(&adapter, &peripheral) => gone(),
            why = self.over() => why,
        };
        *lock(&self.outgoing) = None;
        let _ = within(FAREWELL, peripheral.disconnect()).await;
        Ok(why)
    }

    /// Finds the requested board as soon as the board is in range.
    async fn find(&self, adapter: &Adapter) -> Result<Seen, String> {
        scan(adapter, self.hand).await?;
        let bonds = Bonds::open().await?;
        let mut looks = 0;
        let found = within(SEARCH, async {
            loop {
                let found = candidates(adapter, self.hand).await?;
                let wanted = found.into_iter().filter(|seen| seen.is(self.name.as_deref()));
                let bonded = bonds.addresses().await?;
                let (ours, strange): (Vec<Seen>, Vec<Seen>) =
                    wanted.partition(|seen| self.allow_unbonded || bonded.contains(&seen.address));
                if let Some(best) =
                    ours.into_iter().max_by_key(|seen| rank(bonded.contains(&seen.address), seen.rssi_dbm))
                {
                    return Ok(best);
                }
                looks += 1;
                if let Some(stranger) = strange.first().filter(|_| looks > LOOKS_FOR_BONDED) {
                    return Err(unbonded(&stranger.name, &stranger.address));
                }
                if adapter.adapter_state().await.is_ok_and(|state| state == CentralState::PoweredOff) {
                    return Err(off());
                }
                tokio::time::sleep(LOOK).await;
            }
        });
        let found = found.await;
        let _ = adapter.stop_scan().await;
        found.unwrap_or_else(|| {
            let hand = self.hand.map_or(String::new(), |hand| format!("{hand} "));
            let what = match &self.name {
                Some(name) => format!("{name} is not in reach as a {hand}hand"),
                None => format!("no {hand}hand is in reach"),
            };
            Err(format!(
                "Bluetooth: {what}; is the board on, with the firmware that has Bluetooth, and not \
                 connected elsewhere? `host-bridge list` shows who is there"
            ))
        })
    }

    async fn listen(&self, mut notes: impl futures::Stream<Item = btleplug::api::ValueNotification> + Unpin) {
        while let Some(note) = notes.next().await {
            if note.uuid == FROM_BOARD {
                self.tell(News::Bytes(note.value));
            }
        }
    }
}

async fn within<T>(patience: Duration, what: impl Future<Output = T>) -> Option<T> {
    tokio::time::timeout(patience, what).await.ok()
}

/// Writes outgoing frames. Returns the reason for a failure if the link itself is still connected.
async fn write(
    board: &Peripheral,
    to: &Characteristic,
    mut waiting: mpsc::Receiver<Vec<u8>>,
    name: &str,
) -> Option<String> {
    let room = board.mtu().saturating_sub(HEADER).max(LEAST_PAYLOAD).into();
    while let Some(frame) = waiting.recv().await {
        for piece in frame.chunks(room) {
            if let Err(error) = board.write(to, piece, WriteType::WithResponse).await {
                let text = error.to_string();
                let refused = ["paired", "uthenti", "ncrypt", "ermi"].iter().any(|word| text.contains(word));
                return refused.then(|| {
                    format!(
                        "{name} (Bluetooth) takes nothing from a laptop that is not paired: {} ({text})",
                        how_to_pair(&board.address().to_string())
                    )
                });
            }
        }
    }
    None
}

/// Waits until the board or Bluetooth itself has disappeared.
async fn watch(adapter: &Adapter, board: &Peripheral) {
    loop {
        tokio::time::sleep(LOOK).await;
        let powered = adapter.adapter_state().await.is_ok_and(|state| state == CentralState::PoweredOn);
        if !powered || !board.is_connected().await.unwrap_or(false) {
            return;
        }
    }
}

/// Returns the two characteristics of a connected board.
async fn connect(
    board: &Peripheral,
    name: &str,
    hand: Option<Hand>,
) -> Result<(Characteristic, Characteristic), String> {
    board.connect().await.map_err(|error| trouble(&error))?;
    board.discover_services().await.map_err(|error| trouble(&error))?;
    let all: Vec<Characteristic> = board.services().into_iter().flat_map(|s| s.characteristics).collect();
    let services = services(hand);
    let find = |uuid| all.iter().find(|c| c.uuid == uuid && services.contains(&c.service_uuid)).cloned();
    match (find(FROM_BOARD), find(TO_BOARD)) {
        (Some(input), Some(output)) => Ok((input, output)),
        _ => Err(format!("{name} (Bluetooth) is no hand of this version; flash firmware-nano33 again")),
    }
}

/// A board that advertises.
struct Seen {
    peripheral: Peripheral,
    name: String,
    address: String,
    rssi_dbm: Option<i16>,
}

impl Seen {
    fn is(&self, wanted: Option<&str>) -> bool {
        wanted.is_none_or(|wanted| wanted == self.name || wanted.eq_ignore_ascii_case(&self.address))
    }
}

/// The board with the highest rank is chosen: bonded boards come first, then the strongest signal.
fn rank(is_bonded: bool, rssi_dbm: Option<i16>) -> (bool, Option<i16>) {
    (is_bonded, rssi_dbm)
}

async fn scan(adapter: &Adapter, hand: Option<Hand>) -> Result<(), String> {
    adapter.start_scan(ScanFilter { services: services(hand) }).await.map_err(|error| trouble(&error))
}

/// Returns boards for these hands that are present, because the system also remembers absent ones.
async fn candidates(adapter: &Adapter, hand: Option<Hand>) -> Result<Vec<Seen>, String> {
    let (mut found, wanted) = (Vec::new(), services(hand));
    for peripheral in adapter.peripherals().await.map_err(|error| trouble(&error))? {
        // A board that disappears in the meantime is ignored.
        let Ok(Some(about)) = peripheral.properties().await else { continue };
        let near = about.rssi.is_some() || peripheral.is_connected().await.unwrap_or(false);
        if near && about.services.iter().any(|service| wanted.contains(service)) {
            let address = about.address.to_string();
            let name = about.local_name.unwrap_or_else(|| address.clone());
            found.push(Seen { peripheral, name, address, rssi_dbm: about.rssi });
        }
    }
    Ok(found)
}

/// Returns an enabled adapter. btleplug could enable one itself, but this is the user's decision.
async fn adapter() -> Result<(Manager, Adapter), String> {
    let manager = Manager::new().await.map_err(|error| trouble(&error))?;
    let adapters = manager.adapters().await.map_err(|error| trouble(&error))?;
    if adapters.is_empty() {
        return Err(
            "Bluetooth: this computer has no adapter; plug one in, or connect the board with its USB cable"
                .into(),
        );
    }
    for adapter in adapters {
        if adapter.adapter_state().await.is_ok_and(|state| state == CentralState::PoweredOn) {
            return Ok((manager, adapter));
        }
    }
    Err(off())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bonded_board_is_taken_before_a_louder_one_and_else_the_loudest() {
        assert!(rank(true, Some(-90)) > rank(false, Some(-30)));
        assert!(rank(true, None) > rank(false, Some(-30)));
        assert!(rank(false, Some(-40)) > rank(false, Some(-60)));
    }

    #[test]
    fn a_left_hand_is_no_candidate_for_a_right_one() {
        assert_eq!(services(Some(Hand::Right)), [SERVICES.right]);
        assert_eq!(services(Some(Hand::Left)), [SERVICES.left]);
        assert_eq!(services(None).len(), 2);
        assert_ne!(SERVICES.left, SERVICES.right);
    }
}
