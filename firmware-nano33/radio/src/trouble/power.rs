//! Watches the USB cable. Its power events share an interrupt with mpsl's clocks.
//! While the cable is connected, USB needs the fast crystal.

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

/// Whether the USB cable is connected.
static CABLE: Watch<CriticalSectionRawMutex, bool, 1> = Watch::new();

/// Waits until the USB cable is connected or disconnected. Only one task may wait.
pub async fn cable(wanted: bool) {
    if let Some(mut cable) = CABLE.receiver() {
        cable.get_and(|&is| is == wanted).await;
    }
}

static CHANGED: Signal<CriticalSectionRawMutex, ()> = Signal::new();

/// Reports that the state of the cable has changed.
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

/// Returns whether the cable is connected, and whether its regulator is ready.
fn look() -> (bool, bool) {
    let status = POWER.usbregstatus().read();
    (status.vbusdetect(), status.outputrdy())
}

/// The USB driver's initial state: no cable is connected.
pub fn unplugged() -> SoftwareVbusDetect {
    SoftwareVbusDetect::new(false, false)
}

/// Informs the USB driver and the serial port about the cable.
#[embassy_executor::task]
pub async fn run(mpsl: &'static MultiprotocolServiceLayer<'static>, vbus: &'static SoftwareVbusDetect) -> ! {
    POWER.intenset().write(|w| {
        w.set_usbdetected(true);
        w.set_usbremoved(true);
        w.set_usbpwrrdy(true);
    });
    // SAFETY: the interrupt's handlers are bound, and mpsl has set its priority.
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
