//! Serial port on the board's header at 115200 baud, 8N1. The pins do not tolerate 5 V.
//!
//! An enabled receiver keeps the fast clock running, which draws half a milliampere or more.
//! The Bluetooth image may run on a battery, so it enables this port only while the USB cable is connected.

use embassy_futures::join::join;
use embassy_nrf::buffered_uarte::{self, BufferedUarte};
use embassy_nrf::gpio::{AnyPin, Pin, Port};
use embassy_nrf::peripherals::{PPI_CH0, PPI_CH1, PPI_GROUP0, TIMER1, UARTE0};
use embassy_nrf::{Peri, bind_interrupts, pac, uarte};
use static_cell::ConstStaticCell;

use crate::link::{Inlet, WayOut};

bind_interrupts!(struct Irqs {
    UARTE0 => buffered_uarte::InterruptHandler<UARTE0>;
});

/// The peripherals of the driver, which counts received bytes with a timer.
pub struct Parts {
    /// The controller.
    pub uarte: Peri<'static, UARTE0>,
    /// Counts bytes.
    pub timer: Peri<'static, TIMER1>,
    /// Wiring of the counting.
    pub ppi: (Peri<'static, PPI_CH0>, Peri<'static, PPI_CH1>, Peri<'static, PPI_GROUP0>),
    /// The pin that receives from the laptop.
    pub rx: Peri<'static, AnyPin>,
    /// The pin that sends to the laptop.
    pub tx: Peri<'static, AnyPin>,
}

static RX: ConstStaticCell<[u8; 256]> = ConstStaticCell::new([0; 256]);
static TX: ConstStaticCell<[u8; 256]> = ConstStaticCell::new([0; 256]);

/// Sends and receives without end.
#[cfg(not(feature = "radio"))]
#[embassy_executor::task]
pub async fn run(mut parts: Parts) -> ! {
    serve(&mut parts, RX.take(), TX.take()).await
}

/// Sends and receives while the USB cable is connected.
#[cfg(feature = "radio")]
#[embassy_executor::task]
pub async fn run(mut parts: Parts) -> ! {
    let (rx, tx) = (RX.take(), TX.take());
    loop {
        crate::radio::cable(true).await;
        embassy_futures::select::select(serve(&mut parts, rx, tx), crate::radio::cable(false)).await;
        WayOut::Uart.outbox().set_open(false);
    }
}

async fn serve(parts: &mut Parts, rx: &mut [u8], tx: &mut [u8]) -> ! {
    let mut config = uarte::Config::default();
    config.baudrate = uarte::Baudrate::Baud115200;
    let (ppi1, ppi2, group) = &mut parts.ppi;
    let (port, pin) = (parts.rx.port(), parts.rx.pin());
    let uart = BufferedUarte::new(
        parts.uarte.reborrow(),
        parts.timer.reborrow(),
        ppi1.reborrow(),
        ppi2.reborrow(),
        group.reborrow(),
        parts.rx.reborrow(),
        parts.tx.reborrow(),
        Irqs,
        config,
        rx,
        tx,
    );
    // The driver leaves the receive pin floating, so an unconnected pin would receive noise.
    let pins = match port {
        Port::Port0 => pac::P0,
        Port::Port1 => pac::P1,
    };
    pins.pin_cnf(pin.into()).modify(|w| w.set_pull(pac::gpio::vals::Pull::Pullup));
    let (mut rx, mut tx) = uart.split();
    let outbox = WayOut::Uart.outbox();
    // A serial line does not indicate whether anybody listens.
    outbox.set_open(true);
    let send = async {
        loop {
            let frame = outbox.next().await;
            let mut rest = frame.as_slice();
            while !rest.is_empty() {
                match tx.write(rest).await {
                    Ok(n) => rest = &rest[n..],
                    Err(_) => break,
                }
            }
        }
    };
    let receive = async {
        let mut inlet = Inlet::new(WayOut::Uart);
        loop {
            let Ok(bytes) = rx.fill_buf().await else { continue };
            let len = bytes.len();
            inlet.take(bytes, true).await;
            rx.consume(len);
        }
    };
    join(send, receive).await;
    unreachable!("both run for ever")
}
