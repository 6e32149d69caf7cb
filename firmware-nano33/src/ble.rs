//! Bluetooth through the SoftDevice S140 7.x: one own service, notify out, write in.
//!
//! | | UUID |
//! |---|---|
//! | service | `b1a40001-6d61-4e75-a1b2-5c3d9e7f0a33` |
//! | frames to the laptop (notify) | `b1a40002-…` |
//! | frames to the board (write, write without response; needs an encrypted, bonded link) | `b1a40003-…` |
//!
//! Frames form a byte stream in both directions, split at any byte according to the MTU.
//! Any laptop may read states; `bonds.rs` decides which laptop may write.
//! Only these two files and `flash.rs` use nrf-softdevice.

use core::sync::atomic::{AtomicU32, Ordering};

use embassy_executor::Spawner;
use embassy_futures::join::join4;
use embassy_futures::select::select;
use embassy_nrf::Peri;
use embassy_nrf::peripherals::USBD;
use embassy_nrf::usb::vbus_detect::SoftwareVbusDetect;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use embassy_sync::watch::Watch;
use embassy_time::{Duration, Timer};
use nrf_softdevice::ble::advertisement_builder::{Flag, LegacyAdvertisementBuilder, ServiceList};
use nrf_softdevice::ble::gatt_server::NotifyValueError;
use nrf_softdevice::ble::{Connection, SecurityMode, gatt_server, peripheral};
use nrf_softdevice::{SocEvent, Softdevice, raw};
use shared_board::models::ModelStore;
use shared_proto::frame::DELIMITER;
use static_cell::StaticCell;

use crate::bonds::{Bonder, save_bonds};
use crate::control;
use crate::flash::SoftDeviceFlash;
use crate::link::{Inlet, WayOut};
use crate::storage::Slots;

/// Maximum payload of one notification or write: the largest MTU less a 3-byte header.
const PAYLOAD: usize = 244;
/// Number of notifications that the SoftDevice queues.
/// A state every 80 ms needs one entry; raw batches and replies need more.
const QUEUE: u8 = 8;
/// Connection intervals to request in order, in units of 1.25 ms: 7.5 to 15 ms,
/// then 15 ms for systems that reject less.
const INTERVALS: [(u16, u16); 2] = [(6, 12), (12, 12)];
/// Time within which a laptop replies to a request for a connection interval.
const ANSWER: Duration = Duration::from_secs(5);
/// Number of connection events that the board may skip while it has no data to send.
/// Data from the board still leaves within one interval, and a frame from the laptop arrives within five intervals.
/// The radio is off during the skipped events.
const LATENCY: u16 = 4;
/// Supervision timeout in units of 10 ms: a link without packets for this long is lost.
const SUPERVISION: u16 = 200;
/// Advertising interval in units of 0.625 ms: 30 ms.
const ADVERTISING: u32 = 48;
/// If a laptop has written nothing for this long, the board requests the connection interval again.
/// S140 expects an authenticated packet at least every 480 s, and the reply to the request is such a packet.
/// Without one, and if the laptop does not support LE Ping, S140 raises an event on which nrf-softdevice panics.
const QUIET: Duration = Duration::from_secs(120);
/// A laptop that has not bonded within this time is disconnected, because it occupies the board's only link.
const STRANGER: Duration = Duration::from_secs(10);
const NAME: &str = "bimanual-right";
/// UUID of the service, in the little-endian order of advertisements.
const SERVICE_UUID: [u8; 16] = 0xb1a4_0001_6d61_4e75_a1b2_5c3d_9e7f_0a33_u128.to_le_bytes();

type Payload = heapless08::Vec<u8, PAYLOAD>;

#[nrf_softdevice::gatt_service(uuid = "b1a40001-6d61-4e75-a1b2-5c3d9e7f0a33")]
struct HandService {
    #[characteristic(uuid = "b1a40002-6d61-4e75-a1b2-5c3d9e7f0a33", notify)]
    out: Payload,
    #[characteristic(
        uuid = "b1a40003-6d61-4e75-a1b2-5c3d9e7f0a33",
        write,
        write_without_response,
        security = "justworks"
    )]
    input: Payload,
}

#[nrf_softdevice::gatt_server]
struct Server {
    hand: HandService,
}

/// Starts the SoftDevice.
/// Call `embassy_nrf::init` first, because it writes registers that belong to S140 after this call.
pub fn enable() -> &'static mut Softdevice {
    let config = nrf_softdevice::Config {
        // This must be the clock source of embassy-nrf, otherwise S140 restarts the clock.
        clock: Some(raw::nrf_clock_lf_cfg_t {
            source: raw::NRF_CLOCK_LF_SRC_XTAL as u8,
            rc_ctiv: 0,
            rc_temp_ctiv: 0,
            accuracy: raw::NRF_CLOCK_LF_ACCURACY_50_PPM as u8,
        }),
        conn_gap: Some(raw::ble_gap_conn_cfg_t { conn_count: 1, event_length: 6 }),
        conn_gatt: Some(raw::ble_gatt_conn_cfg_t { att_mtu: PAYLOAD as u16 + 3 }),
        conn_gatts: Some(raw::ble_gatts_conn_cfg_t { hvn_tx_queue_size: QUEUE }),
        gap_role_count: Some(raw::ble_gap_cfg_role_count_t {
            adv_set_count: 1,
            periph_role_count: 1,
            central_role_count: 0,
            central_sec_count: 0,
            _bitfield_1: raw::ble_gap_cfg_role_count_t::new_bitfield_1(0),
        }),
        gap_device_name: Some(raw::ble_gap_cfg_device_name_t {
            p_value: NAME.as_ptr().cast_mut(),
            current_len: NAME.len() as u16,
            max_len: NAME.len() as u16,
            write_perm: SecurityMode::NoAccess.into_raw(),
            _bitfield_1: raw::ble_gap_cfg_device_name_t::new_bitfield_1(raw::BLE_GATTS_VLOC_STACK as u8),
        }),
        ..Default::default()
    };
    Softdevice::enable(&config)
}

/// Returns a random number from S140's pool, or 0 if the pool is still empty.
pub fn random(softdevice: &Softdevice) -> u32 {
    let mut bytes = [0; 4];
    for _ in 0..100_000 {
        if nrf_softdevice::random_bytes(softdevice, &mut bytes).is_ok() {
            break;
        }
    }
    u32::from_le_bytes(bytes)
}

/// Answers the laptop.
#[embassy_executor::task]
pub async fn run_control(store: ModelStore<Slots<SoftDeviceFlash>>) {
    control::run(store).await
}

/// Whether the USB cable is connected.
static CABLE: Watch<CriticalSectionRawMutex, bool, 1> = Watch::new();

/// Waits until the USB cable is connected (`true`) or disconnected (`false`). Only one task may call this.
pub async fn cable(wanted: bool) {
    if let Some(mut cable) = CABLE.receiver() {
        cable.get_and(|&is| is == wanted).await;
    }
}

/// Bits of USBREGSTATUS: the cable is connected, and the output of the regulator is ready.
const VBUS_DETECTED: u32 = 1;
const OUTPUT_READY: u32 = 2;

fn usb_power() -> u32 {
    let mut status = 0;
    // SAFETY: plain call of the enabled SoftDevice.
    unsafe { raw::sd_power_usbregstatus_get(&mut status) };
    status
}

/// Processes S140's events, and forwards those about cable and power to the USB driver.
#[embassy_executor::task]
async fn run_softdevice(softdevice: &'static Softdevice, vbus: &'static SoftwareVbusDetect) -> ! {
    softdevice
        .run_with_callback(|event| match event {
            SocEvent::PowerUsbDetected => {
                // USB requires the crystal. SAFETY: plain call of the enabled SoftDevice.
                unsafe { raw::sd_clock_hfclk_request() };
                vbus.detected(true);
                // The previous call reset the driver's record that power is ready.
                // If both events are pending, S140 reports "ready" before "detected".
                if usb_power() & OUTPUT_READY != 0 {
                    vbus.ready();
                }
                CABLE.sender().send(true);
            }
            SocEvent::PowerUsbRemoved => {
                // SAFETY: as above.
                unsafe { raw::sd_clock_hfclk_release() };
                vbus.detected(false);
                CABLE.sender().send(false);
            }
            SocEvent::PowerUsbPowerReady => vbus.ready(),
            _ => {}
        })
        .await
}

#[embassy_executor::task]
async fn run_usb(usbd: Peri<'static, USBD>, vbus: &'static SoftwareVbusDetect) {
    crate::usb::run(usbd, vbus).await
}

/// Advertises, serves one laptop, and then advertises again, for ever.
#[embassy_executor::task]
async fn run_radio(softdevice: &'static Softdevice, server: &'static Server, bonder: &'static Bonder) -> ! {
    static ADVERTISEMENT: nrf_softdevice::ble::advertisement_builder::LegacyAdvertisementPayload =
        LegacyAdvertisementBuilder::new()
            .flags(&[Flag::GeneralDiscovery, Flag::LE_Only])
            .services_128(ServiceList::Complete, &[SERVICE_UUID])
            .build();
    static SCAN_RESPONSE: nrf_softdevice::ble::advertisement_builder::LegacyAdvertisementPayload =
        LegacyAdvertisementBuilder::new().full_name(NAME).build();
    loop {
        let config = peripheral::Config { interval: ADVERTISING, ..Default::default() };
        let advertisement = peripheral::ConnectableAdvertisement::ScannableUndirected {
            adv_data: &ADVERTISEMENT,
            scan_data: &SCAN_RESPONSE,
        };
        bonder.forget_link();
        match peripheral::advertise_pairable(softdevice, advertisement, &config, bonder).await {
            Ok(connection) => serve(&connection, server, bonder).await,
            Err(_) => Timer::after(Duration::from_millis(100)).await,
        }
    }
}

/// Writes on their way from S140's callback to the decoder.
/// A write that does not fit is lost, and the laptop repeats it.
static WRITES: Channel<CriticalSectionRawMutex, Payload, 4> = Channel::new();

/// Writes so far.
static WRITTEN: AtomicU32 = AtomicU32::new(0);

fn ask_for(connection: &Connection, (min, max): (u16, u16)) {
    let _ = connection.set_conn_params(raw::ble_gap_conn_params_t {
        min_conn_interval: min,
        max_conn_interval: max,
        slave_latency: LATENCY,
        conn_sup_timeout: SUPERVISION,
    });
}

/// Requests an interval until the laptop grants one or the list ends. Later repeats the request when the link is quiet.
async fn negotiate(connection: &Connection) {
    let mut asked = INTERVALS[0];
    for interval in INTERVALS {
        asked = interval;
        ask_for(connection, asked);
        Timer::after(ANSWER).await;
        if connection.conn_params().max_conn_interval <= asked.1 {
            break;
        }
    }
    loop {
        let written = WRITTEN.load(Ordering::Relaxed);
        Timer::after(QUIET).await;
        if WRITTEN.load(Ordering::Relaxed) == written {
            ask_for(connection, asked);
        }
    }
}

/// Queues a piece of a frame.
/// Returns false if the queue stays full for longer than a hop, because the frame is then late.
async fn queue(connection: &Connection, server: &Server, piece: &[u8]) -> bool {
    let Ok(piece) = Payload::from_slice(piece) else { return false };
    // The queue empties once per connection interval.
    for _ in 0..16 {
        match server.hand.out_notify(connection, &piece) {
            Ok(()) => return true,
            Err(NotifyValueError::Disconnected) => return false,
            Err(NotifyValueError::Raw(_)) => Timer::after(Duration::from_millis(5)).await,
        }
    }
    false
}

async fn serve(connection: &Connection, server: &Server, bonder: &Bonder) {
    let outbox = WayOut::Ble.outbox();
    WRITES.clear();
    let events = gatt_server::run(connection, server, |ServerEvent::Hand(event)| match event {
        HandServiceEvent::OutCccdWrite { notifications } => {
            outbox.set_open(notifications);
            bonder.keep_subscription(connection);
        }
        HandServiceEvent::InputWrite(bytes) => {
            WRITTEN.fetch_add(1, Ordering::Relaxed);
            let _ = WRITES.try_send(bytes);
        }
    });
    let receive = async {
        let mut inlet = Inlet::new(WayOut::Ble);
        loop {
            let bytes = WRITES.receive().await;
            // S140 has checked through `security` above that the link is encrypted, but not that the laptop is bonded.
            inlet.take(&bytes, bonder.trusts()).await;
        }
    };
    let send = async {
        // Set after only the first part of a frame was sent, so that the laptop does not join it with the next frame.
        let mut torn = false;
        loop {
            let frame = outbox.next().await;
            if torn && !queue(connection, server, &[DELIMITER]).await {
                continue;
            }
            torn = false;
            let room = usize::from(connection.att_mtu()).saturating_sub(3).clamp(20, PAYLOAD);
            for (i, piece) in frame.chunks(room).enumerate() {
                if !queue(connection, server, piece).await {
                    torn = i > 0;
                    break;
                }
            }
        }
    };
    let stranger = async {
        loop {
            Timer::after(STRANGER).await;
            if !bonder.trusts() {
                let _ = connection.disconnect();
            }
        }
    };
    select(events, join4(negotiate(connection), receive, send, stranger)).await;
    outbox.set_open(false);
}

/// Starts the tasks that need the SoftDevice.
pub fn spawn(spawner: Spawner, softdevice: &'static mut Softdevice, usbd: Peri<'static, USBD>) {
    static SERVER: StaticCell<Server> = StaticCell::new();
    static BONDER: StaticCell<Bonder> = StaticCell::new();
    static VBUS: StaticCell<SoftwareVbusDetect> = StaticCell::new();
    let server = match Server::new(softdevice) {
        Ok(server) => &*SERVER.init(server),
        Err(_) => defmt::panic!("the attribute table does not fit S140's memory"),
    };
    let bonder = &*BONDER.init(Bonder::load());
    // SAFETY: plain calls of the enabled SoftDevice.
    unsafe {
        raw::sd_power_usbdetected_enable(1);
        raw::sd_power_usbremoved_enable(1);
        raw::sd_power_usbpwrrdy_enable(1);
    }
    let status = usb_power();
    let plugged = status & VBUS_DETECTED != 0;
    if plugged {
        // SAFETY: as above.
        unsafe { raw::sd_clock_hfclk_request() };
    }
    CABLE.sender().send(plugged);
    let vbus = &*VBUS.init(SoftwareVbusDetect::new(plugged, status & OUTPUT_READY != 0));
    let softdevice = &*softdevice;
    spawner.spawn(run_softdevice(softdevice, vbus).expect("spawned once"));
    spawner.spawn(run_radio(softdevice, server, bonder).expect("spawned once"));
    spawner.spawn(save_bonds(bonder).expect("spawned once"));
    spawner.spawn(run_usb(usbd, vbus).expect("spawned once"));
}
