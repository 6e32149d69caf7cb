//! The USB cable: its power's events share an interrupt with mpsl's clocks, and while it is in, the fast crystal stays on for USB.

use embassy_nrf::interrupt::typelevel::{CLOCK_POWER, Handler};
use embassy_nrf::interrupt::{self, InterruptExt};
use embassy_nrf::pac::POWER;
use embassy_nrf::usb::vbus_detect::SoftwareVbusDetect;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_sync::watch::Watch;
use embassy_time::{Duration, with_timeout};
use nrf_mpsl::{Hfclk, MultiprotocolServiceLayer};

/// The crystal starts in less than a millisecond.
const CRYSTAL: Duration = Duration::from_millis(20);

/// Whether the USB cable is in.
static CABLE: Watch<CriticalSectionRawMutex, bool, 1> = Watch::new();

/// Waits until the USB cable is in, or out. For one task.
pub async fn cable(wanted: bool) {
    if let Some(mut cable) = CABLE.receiver() {
        cable.get_and(|&is| is == wanted).await;
    }
}

static CHANGED: Signal<CriticalSectionRawMutex, ()> = Signal::new();

/// Notes that something about the cable has changed.
pub struct PowerHandler;

impl Handler<CLOCK_POWER> for PowerHandler {
    unsafe fn on_interrupt() {
        let events = [POWER.events_usbdetected(), POWER.events_usbremoved(), POWER.events_usbpwrrdy()];
        for event in events {
            if event.read() != 0 {
                event.write_value(0);
                CHANGED.signal(());
            }
        }
    }
}

/// Whether the cable is in, and whether its regulator is ready.
fn look() -> (bool, bool) {
    let status = POWER.usbregstatus().read();
    (status.vbusdetect(), status.outputrdy())
}

/// What the USB driver is told at first: no cable.
pub fn unplugged() -> SoftwareVbusDetect {
    SoftwareVbusDetect::new(false, false)
}

/// Tells the USB driver and the serial port of the cable.
#[embassy_executor::task]
pub async fn run(mpsl: &'static MultiprotocolServiceLayer<'static>, vbus: &'static SoftwareVbusDetect) -> ! {
    POWER.intenset().write(|w| {
        w.set_usbdetected(true);
        w.set_usbremoved(true);
        w.set_usbpwrrdy(true);
    });
    // SAFETY: its handlers are bound, and mpsl has chosen its priority.
    unsafe { interrupt::CLOCK_POWER.enable() };
    CABLE.sender().send(false);
    let mut crystal = None;
    let mut was_in = false;
    loop {
        let (is_in, is_ready) = look();
        if is_in != was_in {
            was_in = is_in;
            if is_in {
                crystal = mpsl.request_hfclk().await.ok();
                let _ = with_timeout(CRYSTAL, Hfclk::wait()).await;
            } else {
                drop(crystal.take());
            }
            vbus.detected(is_in);
            CABLE.sender().send(is_in);
        }
        if is_ready {
            vbus.ready();
        }
        CHANGED.wait().await;
    }
}
