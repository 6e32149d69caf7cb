//! Bluetooth through the SoftDevice S140 7.x, which is in flash below the image.
//!
//! Any laptop may read states; `bonds.rs` describes which laptops may write. Only this folder uses nrf-softdevice.

mod bonds;
mod flash;

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
use shared_proto::frame::DELIMITER;
use static_cell::StaticCell;

use self::bonds::{Bonder, save_bonds};
pub use self::flash::SoftDeviceFlash as RadioFlash;
use crate::link::{Inlet, WayOut};
use nano33_radio::{
    ADVERTISING, ANSWER, INTERVALS, LATENCY, NAME, PAYLOAD, SERVICE_UUID, STRANGER, SUPERVISION,
};

/// Number of notifications that the SoftDevice queues.
/// A state every 80 ms needs only one notification, but raw batches and answers need more.
const QUEUE: u8 = 8;
/// If a laptop has written nothing for this long, the board requests its interval again.
/// S140 needs an authenticated packet every 480 s, and the answer to this request is such a packet.
/// If a laptop's radio lacks LE Ping, S140 would otherwise raise an event at which nrf-softdevice panics.
const QUIET: Duration = Duration::from_secs(120);

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

/// The enabled SoftDevice.
pub struct Radio(&'static mut Softdevice);

impl Radio {
    /// Starts the SoftDevice. `embassy_nrf::init` must have run, because it writes registers that S140 then owns.
    pub fn start() -> Self {
        Self(enable())
    }

    /// Returns a random number from S140's pool, or 0 if the pool is still empty.
    pub fn random(&mut self) -> u32 {
        let mut bytes = [0; 4];
        for _ in 0..100_000 {
            if nrf_softdevice::random_bytes(self.0, &mut bytes).is_ok() {
                break;
            }
        }
        u32::from_le_bytes(bytes)
    }

    /// The SoftDevice's calls for writing to flash.
    pub fn flash(&mut self) -> RadioFlash {
        RadioFlash::new(self.0)
    }

    /// Starts the tasks that need the SoftDevice.
    pub fn spawn(self, spawner: Spawner, usbd: Peri<'static, USBD>) {
        spawn(spawner, self.0, usbd);
    }
}

fn enable() -> &'static mut Softdevice {
    let config = nrf_softdevice::Config {
        // The clock source must be that of embassy-nrf. Otherwise, S140 restarts the clock.
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

/// Whether the USB cable is connected.
static CABLE: Watch<CriticalSectionRawMutex, bool, 1> = Watch::new();

/// Waits until the USB cable is connected (`true`) or disconnected (`false`). Only one task may call this.
pub async fn cable(wanted: bool) {
    if let Some(mut cable) = CABLE.receiver() {
        cable.get_and(|&is| is == wanted).await;
    }
}

/// Bits of USBREGSTATUS: the cable is connected, and the regulator's output is ready.
const VBUS_DETECTED: u32 = 1;
const OUTPUT_READY: u32 = 2;

fn usb_power() -> u32 {
    let mut status = 0;
    // SAFETY: this is a plain call of the enabled SoftDevice.
    unsafe { raw::sd_power_usbregstatus_get(&mut status) };
    status
}

/// Processes S140's events. Events about cable and power go to the USB driver.
#[embassy_executor::task]
async fn run_softdevice(softdevice: &'static Softdevice, vbus: &'static SoftwareVbusDetect) -> ! {
    softdevice
        .run_with_callback(|event| match event {
            SocEvent::PowerUsbDetected => {
                // USB requires the crystal. SAFETY: this is a plain call of the enabled SoftDevice.
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

/// Written data that waits between S140's callback and the decoder.
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

/// Requests each interval in turn until the laptop grants one.
/// Later, repeats the last request whenever the link is quiet.
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
    // The queue empties once in each connection interval.
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
            // S140 has checked (`security` above) that the link is encrypted, but not that the laptop is bonded.
            inlet.take(&bytes, bonder.trusts()).await;
        }
    };
    let send = async {
        // This is set if only the first part of a frame was sent.
        // The laptop must not join that part with the next frame.
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

fn spawn(spawner: Spawner, softdevice: &'static mut Softdevice, usbd: Peri<'static, USBD>) {
    static SERVER: StaticCell<Server> = StaticCell::new();
    static BONDER: StaticCell<Bonder> = StaticCell::new();
    static VBUS: StaticCell<SoftwareVbusDetect> = StaticCell::new();
    let server = match Server::new(softdevice) {
        Ok(server) => &*SERVER.init(server),
        Err(_) => defmt::panic!("the attribute table does not fit S140's memory"),
    };
    let bonder = &*BONDER.init(Bonder::load());
    // SAFETY: these are plain calls of the enabled SoftDevice.
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
