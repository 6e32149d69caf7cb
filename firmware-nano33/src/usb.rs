//! Serial port over the USB cable (CDC ACM). Opening the port at 1200 baud starts the bootloader.

use embassy_futures::join::join3;
use embassy_futures::select::{Either, select};
use embassy_nrf::peripherals::USBD;
use embassy_nrf::usb::vbus_detect::VbusDetect;
use embassy_nrf::{Peri, bind_interrupts, usb};
use embassy_time::{Duration, Timer, with_timeout};
use embassy_usb::class::cdc_acm::{CdcAcmClass, State};
use embassy_usb::{Builder, Config, UsbVersion};
use static_cell::{ConstStaticCell, StaticCell};

use crate::boards;
use crate::link::{Inlet, WayOut};

bind_interrupts!(struct Irqs {
    USBD => usb::InterruptHandler<USBD>;
});

const TOUCH_BAUD: u32 = 1200;
const PACKET: usize = 64;
/// If a write takes this long, the laptop has stopped reading. Its frames are then dropped, not queued.
const STALLED: Duration = Duration::from_millis(100);

static CONFIG_DESCRIPTOR: ConstStaticCell<[u8; 128]> = ConstStaticCell::new([0; 128]);
static CONTROL: ConstStaticCell<[u8; 64]> = ConstStaticCell::new([0; 64]);
static SERIAL: ConstStaticCell<[u8; 16]> = ConstStaticCell::new([b'0'; 16]);
static STATE: StaticCell<State<'static>> = StaticCell::new();

/// Operates the USB port without end.
pub async fn run<V: VbusDetect + 'static>(usbd: Peri<'static, USBD>, vbus: V) -> ! {
    let driver = usb::Driver::new(usbd, Irqs, vbus);
    let (vendor, product) = boards::USB.ids;
    let mut config = Config::new(vendor, product);
    config.manufacturer = Some("bimanual");
    config.product = Some(boards::USB.product);
    config.serial_number = Some(serial_number());
    config.bcd_usb = UsbVersion::Two;
    let mut builder =
        Builder::new(driver, config, CONFIG_DESCRIPTOR.take(), &mut [], &mut [], CONTROL.take());
    let class = CdcAcmClass::new(&mut builder, STATE.init(State::new()), PACKET as u16);
    let mut device = builder.build();
    let (mut sender, mut receiver, control) = class.split_with_control();
    let outbox = WayOut::Usb.outbox();

    let send = async {
        loop {
            sender.wait_connection().await;
            loop {
                let frame = match select(outbox.next(), control.control_changed()).await {
                    Either::First(frame) => frame,
                    Either::Second(()) => {
                        outbox.set_open(control.dtr());
                        if sender.line_coding().data_rate() == TOUCH_BAUD && !control.dtr() {
                            // During this delay, the laptop receives its reply.
                            Timer::after(Duration::from_millis(50)).await;
                            boards::enter_bootloader();
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
                // A full last packet requires an empty packet to end the transfer.
                if matches!(sent, Ok(Ok(()))) && frame.len() % PACKET == 0 {
                    sent = with_timeout(STALLED, sender.write_packet(&[])).await;
                }
                match sent {
                    Ok(Ok(())) => {}
                    // Nobody reads the frames, so they would be out of date when a reader appears.
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
            let mut inlet = Inlet::new(WayOut::Usb);
            while let Ok(len) = receiver.read_packet(&mut packet).await {
                inlet.take(&packet[..len], true).await;
            }
        }
    };
    join3(device.run(), send, receive).await;
    unreachable!("all run for ever")
}

/// The chip's serial number in hexadecimal. Operating systems use it to distinguish two boards.
fn serial_number() -> &'static str {
    let text = SERIAL.take();
    let id = [1, 0].map(|word| embassy_nrf::pac::FICR.deviceid(word).read());
    for (i, digit) in text.iter_mut().enumerate() {
        let nibble = (id[i / 8] >> (28 - 4 * (i % 8))) & 0xF;
        *digit = b"0123456789ABCDEF"[nibble as usize];
    }
    core::str::from_utf8(text).unwrap_or("0")
}
