//! Advertises, serves one laptop, and advertises again.

use core::cell::Cell;
use core::future::poll_fn;

use embassy_futures::join::join3;
use embassy_futures::select::select;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use embassy_time::{Duration, Timer, with_timeout};
use shared_board::bonds::Bond;
use shared_proto::frame::DELIMITER;
use trouble_host::Error;
use trouble_host::advertise::{
    AdStructure, Advertisement, AdvertisementParameters, BR_EDR_NOT_SUPPORTED, LE_GENERAL_DISCOVERABLE,
};
use trouble_host::connection::RequestedConnParams;
use trouble_host::prelude::{
    AttErrorCode, AttributeHandle, Connection, DefaultPacketPool, FromGatt, GattConnection,
    GattConnectionEvent, GattEvent, Peripheral, PhyKind, WriteEvent, gatt_server, gatt_service,
};

use super::bonds::{Bonds, from_keys};
use super::{Controller, Outbox, Stack, pairing};
use crate::{ADVERTISING, ANSWER, INTERVALS, LATENCY, NAME, PAYLOAD, SERVICE_UUID, STRANGER, SUPERVISION};

/// Maximum number of bytes that a laptop writes at once.
pub type Payload = heapless::Vec<u8, PAYLOAD>;
type Link = GattConnection<'static, 'static, DefaultPacketPool>;

/// A laptop that may bond gets this much time, because its owner must find a question and answer it.
const WHILE_PAIRING: Duration = Duration::from_secs(30);
/// A laptop whose owner types a passkey gets this much time. The laptop itself waits 30 s for the passkey.
const WHILE_TYPING: Duration = Duration::from_secs(60);
/// A passkey is shown for this time. The stack ends a pairing after 30 s without an answer, and does not report it.
const WHILE_SHOWN: Duration = Duration::from_secs(35);
/// Pause between two advertisements.
const IDLE: Duration = Duration::from_millis(50);
/// A piece that was not sent within this time (one hop) is late.
const LATE: Duration = Duration::from_millis(80);
/// Longest packet on the air: its size in bytes, and its duration at 1 Mbit/s.
const LONG_PACKET: (u16, u16) = (PAYLOAD as u16 + 7, 2120);

/// Bytes that laptops have written, with `None` between two laptops. While the queue is full, the link waits.
static WRITTEN: Channel<CriticalSectionRawMutex, Option<Payload>, 2> = Channel::new();

/// Returns the next piece that a trusted laptop has written, or `None` where another link begins.
pub async fn written() -> Option<Payload> {
    WRITTEN.receive().await
}

#[cfg_attr(not(feature = "left"), gatt_service(uuid = "b1a40001-6d61-4e75-a1b2-5c3d9e7f0a33"))]
#[cfg_attr(feature = "left", gatt_service(uuid = "b1a40011-6d61-4e75-a1b2-5c3d9e7f0a33"))]
struct HandService {
    #[characteristic(uuid = "b1a40002-6d61-4e75-a1b2-5c3d9e7f0a33", notify, permissions(encrypted))]
    out: Payload,
    #[characteristic(
        uuid = "b1a40003-6d61-4e75-a1b2-5c3d9e7f0a33",
        write,
        write_without_response,
        permissions(encrypted)
    )]
    input: Payload,
}

#[gatt_server]
pub struct Server {
    hand: HandService,
}

/// The descriptor with which a laptop subscribes to notifications.
struct Listening(u16);

impl AttributeHandle for Listening {
    type Value = [u8; 2];

    fn handle(&self) -> u16 {
        self.0
    }
}

/// Serves one laptop after another, forever.
#[embassy_executor::task]
pub async fn run(
    stack: &'static Stack,
    server: &'static Server<'static>,
    bonds: &'static Bonds,
    outbox: &'static dyn Outbox,
) -> ! {
    let mut peripheral = stack.peripheral();
    loop {
        bonds.restore(stack);
        // The controller accepts its list of changing addresses only while it neither advertises nor has a link.
        Timer::after(IDLE).await;
        match advertise(&mut peripheral).await {
            Some(connection) => match connection.with_attribute_server(&server.server) {
                Ok(link) => {
                    WRITTEN.send(None).await;
                    Visit { link, server, bonds, outbox, trusted: Cell::new(None) }.serve(stack).await;
                }
                Err(_) => Timer::after(Duration::from_millis(100)).await,
            },
            None => Timer::after(Duration::from_millis(100)).await,
        }
    }
}

async fn advertise(
    peripheral: &mut Peripheral<'static, Controller, DefaultPacketPool>,
) -> Option<Connection<'static, DefaultPacketPool>> {
    let (mut adv_data, mut scan_data) = ([0; 31], [0; 31]);
    let said = AdStructure::encode_slice(
        &[
            AdStructure::Flags(LE_GENERAL_DISCOVERABLE | BR_EDR_NOT_SUPPORTED),
            AdStructure::CompleteServiceUuids128(&[SERVICE_UUID]),
        ],
        &mut adv_data,
    )
    .ok()?;
    let named =
        AdStructure::encode_slice(&[AdStructure::CompleteLocalName(NAME.as_bytes())], &mut scan_data).ok()?;
    let interval = Duration::from_micros(ADVERTISING as u64 * 625);
    let parameters =
        AdvertisementParameters { interval_min: interval, interval_max: interval, ..Default::default() };
    let advertisement = Advertisement::ConnectableScannableUndirected {
        adv_data: &adv_data[..said],
        scan_data: &scan_data[..named],
    };
    peripheral.advertise(&parameters, advertisement).await.ok()?.accept().await.ok()
}

/// The link to one laptop.
struct Visit {
    link: Link,
    server: &'static Server<'static>,
    bonds: &'static Bonds,
    outbox: &'static dyn Outbox,
    /// The laptop, once the link is encrypted with its stored keys.
    trusted: Cell<Option<Bond>>,
}

impl Visit {
    /// Serves the laptop until the link ends.
    async fn serve(&self, stack: &'static Stack) {
        select(self.receive(), join3(self.send(), self.watch(), self.negotiate(stack))).await;
        self.outbox.set_open(false);
        pairing::clear();
    }

    async fn receive(&self) {
        loop {
            match self.link.next().await {
                GattConnectionEvent::Disconnected { .. } => return,
                // The laptop pairs again, which is allowed only while laptops may bond.
                GattConnectionEvent::BondLost if !self.bonds.may_bond() => self.hang_up(),
                GattConnectionEvent::PairingComplete { bond: Some(keys), .. } => {
                    let bond = from_keys(&keys);
                    if self.bonds.would_be_weakened_by(&bond) {
                        self.hang_up();
                    } else {
                        self.bonds.keep(bond);
                        self.trust(bond);
                    }
                }
                // The stack asks for a passkey even if the laptop may not bond.
                GattConnectionEvent::PassKeyDisplay(_) if !self.bonds.may_bond() => self.hang_up(),
                GattConnectionEvent::PassKeyDisplay(passkey) => pairing::show(passkey.value()),
                GattConnectionEvent::PairingFailed(_) => self.forget_passkey(),
                // If a laptop does not store its keys, they are useless here.
                GattConnectionEvent::PairingComplete { bond: None, .. } => self.hang_up(),
                GattConnectionEvent::Encrypted { bond: Some(keys), .. } => self.welcome(self.bonds.of(&keys)),
                GattConnectionEvent::Gatt { event: GattEvent::Write(write) } => {
                    self.take(write).await;
                }
                GattConnectionEvent::Gatt { event } => {
                    if let Ok(reply) = event.accept() {
                        reply.send().await;
                    }
                }
                _ => {}
            }
        }
    }

    /// A laptop with stored keys has returned, so its subscription is restored.
    fn welcome(&self, bond: Option<Bond>) {
        self.trusted.set(None);
        if let Some(bond) = bond {
            self.trust(bond);
            let value = [u8::from(bond.listens), 0];
            if let Some(handle) = self.server.hand.out.cccd_handle {
                let _ = self.link.set(&Listening(handle), &value);
            }
            self.outbox.set_open(bond.listens);
        }
    }

    fn trust(&self, bond: Bond) {
        self.trusted.set(Some(bond));
        pairing::set_paired(bond.authenticated);
    }

    /// Shows the passkey no longer. A link that is still encrypted with stored keys is what it was.
    fn forget_passkey(&self) {
        match self.trusted.get() {
            Some(bond) => pairing::set_paired(bond.authenticated),
            None => pairing::clear(),
        }
    }

    async fn take(&self, write: WriteEvent<'static, 'static, DefaultPacketPool>) {
        let handle = write.handle();
        let Some(mut bond) = self.trusted.get() else {
            if let Ok(reply) = write.reject(AttErrorCode::INSUFFICIENT_AUTHORISATION) {
                reply.send().await;
            }
            return;
        };
        let bytes = write.with_data(|_, data| Payload::from_slice(data).unwrap_or_default());
        let answer =
            if handle == self.server.hand.input.handle { write.accept_unprocessed() } else { write.accept() };
        if let Ok(reply) = answer {
            reply.send().await;
        }
        if handle == self.server.hand.input.handle {
            WRITTEN.send(Some(bytes)).await;
        } else if Some(handle) == self.server.hand.out.cccd_handle
            && let [low, _] = bytes[..]
        {
            let listens = low & 1 != 0;
            self.outbox.set_open(listens);
            if bond.listens != listens {
                bond.listens = listens;
                self.trusted.set(Some(bond));
                self.bonds.keep(bond);
            }
        }
    }

    /// Sends frames in pieces.
    async fn send(&self) {
        // Set if the beginning of a frame was sent but its end was not.
        // The end of this frame is then missing, and the next frame must not be mistaken for it.
        let mut torn = false;
        loop {
            let frame = poll_fn(|context| self.outbox.poll_next(context)).await;
            if self.trusted.get().is_none() || (torn && !self.notify(&[DELIMITER]).await) {
                continue;
            }
            torn = false;
            let room = usize::from(self.link.raw().att_mtu()).saturating_sub(3).clamp(20, PAYLOAD);
            for (i, piece) in frame.chunks(room).enumerate() {
                if !self.notify(piece).await {
                    torn = i > 0;
                    break;
                }
            }
        }
    }

    /// Queues a piece of a frame.
    /// Returns false if there is no room for longer than a hop, because the piece is then late.
    async fn notify(&self, piece: &[u8]) -> bool {
        let out = &self.server.hand.out;
        let queued = with_timeout(LATE, async {
            loop {
                match out.notify_raw(&self.link, piece, false).await {
                    Err(Error::OutOfMemory) => Timer::after(Duration::from_millis(5)).await,
                    other => return other,
                }
            }
        });
        matches!(queued.await, Ok(Ok(())))
    }

    /// Lets a laptop bond while this is allowed.
    /// Disconnects a laptop that is still not trusted after some time.
    async fn watch(&self) {
        let mut waited = Duration::from_secs(0);
        let mut shown = (None, Duration::from_secs(0));
        loop {
            let may_bond = self.bonds.may_bond();
            let passkey = pairing::passkey();
            if passkey != shown.0 {
                shown = (passkey, Duration::from_secs(0));
            }
            // The stack gives up after 30 s without saying so.
            if passkey.is_some() && shown.1 > WHILE_SHOWN {
                self.forget_passkey();
            }
            let _ = self.link.raw().set_bondable(may_bond);
            let patience = match passkey {
                Some(_) => WHILE_TYPING,
                None if may_bond => WHILE_PAIRING,
                None => STRANGER,
            };
            if self.trusted.get().is_some() {
                waited = Duration::from_secs(0);
            } else if waited >= patience {
                self.hang_up();
            }
            Timer::after(Duration::from_secs(1)).await;
            waited += Duration::from_secs(1);
            shown.1 += Duration::from_secs(1);
        }
    }

    /// Requests long packets and the faster radio mode.
    /// Then requests one connection interval after another, until the laptop accepts one or keeps its own.
    async fn negotiate(&self, stack: &'static Stack) {
        let raw = self.link.raw();
        let _ = with_timeout(ANSWER, raw.update_data_length(stack, LONG_PACKET.0, LONG_PACKET.1)).await;
        let _ = with_timeout(ANSWER, raw.set_phy(stack, PhyKind::Le2M)).await;
        for (min, max) in INTERVALS {
            let units = |n: u16| Duration::from_micros(u64::from(n) * 1250);
            let wanted = RequestedConnParams {
                min_connection_interval: units(min),
                max_connection_interval: units(max),
                max_latency: LATENCY,
                min_event_length: Duration::from_ticks(0),
                max_event_length: Duration::from_ticks(0),
                supervision_timeout: Duration::from_millis(u64::from(SUPERVISION) * 10),
            };
            let _ = with_timeout(ANSWER, raw.update_connection_params(stack, &wanted)).await;
            Timer::after(ANSWER).await;
            if raw.params().conn_interval <= units(max) {
                break;
            }
        }
    }

    fn hang_up(&self) {
        self.link.raw().disconnect();
    }
}
