//! A serial port over the USB cable (CDC ACM). A touch at 1200 baud returns to the bootloader.

use embassy_futures::join::join3;
use embassy_futures::select::{Either, select};
use embassy_nrf::peripherals::USBD;
use embassy_nrf::usb::vbus_detect::VbusDetect;
use embassy_nrf::{Peri, bind_interrupts, usb};
use embassy_time::{Duration, Timer, with_timeout};
use embassy_usb::class::cdc_acm::{CdcAcmClass, State};
use embassy_usb::{Builder, Config, UsbVersion};
use static_cell::{ConstStaticCell, StaticCell};

use crate::link::{Inlet, Link};

bind_interrupts!(struct Irqs {
    USBD => usb::InterruptHandler<USBD>;
});

/// Arduino's ids for a sketch on this board, which its drivers and udev rules know.
const VENDOR: u16 = 0x2341;
const PRODUCT: u16 = 0x805A;
const TOUCH_BAUD: u32 = 1200;
const PACKET: usize = 64;
/// Word that the stock bootloader looks for in GPREGRET after a reset.
const STAY_IN_BOOTLOADER: u8 = 0xB0;
/// A laptop that stopped reading: its frames are dropped, not queued.
const STALLED: Duration = Duration::from_millis(100);

static CONFIG_DESCRIPTOR: ConstStaticCell<[u8; 128]> = ConstStaticCell::new([0; 128]);
static CONTROL: ConstStaticCell<[u8; 64]> = ConstStaticCell::new([0; 64]);
static STATE: StaticCell<State<'static>> = StaticCell::new();

/// Serves the port for ever.
pub async fn run<V: VbusDetect + 'static>(usbd: Peri<'static, USBD>, vbus: V) -> ! {
    let driver = usb::Driver::new(usbd, Irqs, vbus);
    let mut config = Config::new(VENDOR, PRODUCT);
    config.manufacturer = Some("bimanual");
    config.product = Some("bimanual right hand");
    config.bcd_usb = UsbVersion::Two;
    let mut builder =
        Builder::new(driver, config, CONFIG_DESCRIPTOR.take(), &mut [], &mut [], CONTROL.take());
    let class = CdcAcmClass::new(&mut builder, STATE.init(State::new()), PACKET as u16);
    let mut device = builder.build();
    let (mut sender, mut receiver, control) = class.split_with_control();
    let outbox = Link::Usb.outbox();

    let send = async {
        loop {
            sender.wait_connection().await;
            loop {
                let frame = match select(outbox.next(), control.control_changed()).await {
                    Either::First(frame) => frame,
                    Either::Second(()) => {
                        outbox.set_open(control.dtr());
                        if sender.line_coding().data_rate() == TOUCH_BAUD && !control.dtr() {
                            enter_bootloader().await;
                        }
                        continue;
                    }
                };
                let mut sent = Ok(Ok(()));
                for packet in frame.chunks(PACKET) {
                    sent = with_timeout(STALLED, sender.write_packet(packet)).await;
                    if !matches!(sent, Ok(Ok(()))) {
                        break;
                    }
                }
                // A full last packet needs an empty one to end the transfer.
                if matches!(sent, Ok(Ok(()))) && frame.len() % PACKET == 0 {
                    sent = with_timeout(STALLED, sender.write_packet(&[])).await;
                }
                match sent {
                    Ok(Ok(())) => {}
                    // Nobody reads: what waits is old by the time somebody does.
                    Err(_) => outbox.forget(),
                    Ok(Err(_)) => break,
                }
            }
            outbox.set_open(false);
        }
    };
    let receive = async {
        let mut packet = [0; PACKET];
        loop {
            receiver.wait_connection().await;
            let mut inlet = Inlet::new(Link::Usb);
            while let Ok(len) = receiver.read_packet(&mut packet).await {
                inlet.take(&packet[..len], true).await;
            }
        }
    };
    join3(device.run(), send, receive).await;
    unreachable!("all run for ever")
}

/// Restarts into the stock bootloader.
async fn enter_bootloader() -> ! {
    // The laptop gets its answer first.
    Timer::after(Duration::from_millis(50)).await;
    #[cfg(not(feature = "ble"))]
    embassy_nrf::pac::POWER.gpregret().write(|w| w.set_gpregret(STAY_IN_BOOTLOADER));
    // SAFETY: plain calls of the enabled SoftDevice, which owns the register.
    #[cfg(feature = "ble")]
    unsafe {
        nrf_softdevice::raw::sd_power_gpregret_set(0, STAY_IN_BOOTLOADER.into());
    }
    cortex_m::peripheral::SCB::sys_reset()
}
