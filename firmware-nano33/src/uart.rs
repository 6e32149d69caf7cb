//! D0 (TX, P1.03) and D1 (RX, P1.10) at 115200 baud, 8N1. Not 5 V tolerant.

use embassy_futures::join::join;
use embassy_nrf::buffered_uarte::{self, BufferedUarte};
use embassy_nrf::peripherals::{P1_03, P1_10, PPI_CH0, PPI_CH1, PPI_GROUP0, TIMER1, UARTE0};
use embassy_nrf::{Peri, bind_interrupts, uarte};
use static_cell::ConstStaticCell;

use crate::link::{Inlet, Link};

bind_interrupts!(struct Irqs {
    UARTE0 => buffered_uarte::InterruptHandler<UARTE0>;
});

/// What the driver takes: it counts received bytes with a timer.
pub struct Parts {
    /// The controller.
    pub uarte: Peri<'static, UARTE0>,
    /// Counts bytes.
    pub timer: Peri<'static, TIMER1>,
    /// Wiring of the counting.
    pub ppi: (Peri<'static, PPI_CH0>, Peri<'static, PPI_CH1>, Peri<'static, PPI_GROUP0>),
    /// D1.
    pub rx: Peri<'static, P1_10>,
    /// D0.
    pub tx: Peri<'static, P1_03>,
}

static RX: ConstStaticCell<[u8; 256]> = ConstStaticCell::new([0; 256]);
static TX: ConstStaticCell<[u8; 256]> = ConstStaticCell::new([0; 256]);

/// Sends and receives for ever.
#[embassy_executor::task]
pub async fn run(parts: Parts) -> ! {
    let mut config = uarte::Config::default();
    config.baudrate = uarte::Baudrate::Baud115200;
    let (ppi1, ppi2, group) = parts.ppi;
    let uart = BufferedUarte::new(
        parts.uarte,
        parts.timer,
        ppi1,
        ppi2,
        group,
        parts.rx,
        parts.tx,
        Irqs,
        config,
        RX.take(),
        TX.take(),
    );
    let (mut rx, mut tx) = uart.split();
    let outbox = Link::Uart.outbox();
    // A wire does not say whether somebody listens.
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
        let mut inlet = Inlet::new(Link::Uart);
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
