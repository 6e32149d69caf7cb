//! The receiving task passes the laptop's messages to the board and to the model store.
//! The board and the store reply to these messages.

use embassy_time::{Duration, Timer};
#[cfg(feature = "trouble")]
use shared_board::images::{ImageStore, Then};
use shared_board::models::{MappedFlash, ModelStore};
#[cfg(feature = "trouble")]
use shared_board::update::Source;
use shared_proto::frame::parse_host;
use shared_proto::message::HostMessage;

use crate::link::INBOX;
#[cfg(feature = "trouble")]
use crate::link::WayOut;
use crate::{about, board, state, vibrate};

/// Pause after the erasure of a page, during which the processor stops for 85 ms. The sensor's FIFO holds 134 ms.
const PAUSE: Duration = Duration::from_millis(40);
/// Time between the answer to an image's commit and the restart, so that the answer reaches the laptop.
#[cfg(feature = "trouble")]
const LAST_WORDS: Duration = Duration::from_millis(300);

/// Answers the laptop's requests forever.
pub async fn run<F: MappedFlash>(
    mut store: ModelStore<F>,
    #[cfg(feature = "trouble")] mut images: ImageStore<impl MappedFlash>,
) -> ! {
    loop {
        let received = INBOX.receive().await;
        let mut link = received.link;
        // Messages that this version does not know get no reply. Damaged frames were already counted.
        let Ok(message) = parse_host(&received.payload) else { continue };
        let request =
            board::with(|board| board.receive(&message, received.trusted, state::now_ms(), &mut link));
        if matches!(message, HostMessage::Feel { .. }) {
            vibrate::FELT.signal(());
        }
        #[cfg(feature = "trouble")]
        if received.trusted && matches!(message, HostMessage::HelloRequest) {
            // If the mark cannot be stored, the laptop learns this when it asks about the image.
            images.said_hello().await;
        }
        if let Some(request) = request {
            #[cfg(feature = "trouble")]
            {
                let source = if link == WayOut::Ble { Source::Air } else { Source::Cable };
                let pause = async || Timer::after(PAUSE).await;
                match images.answer(&request, source, pause, &mut link).await {
                    Then::Pass => {}
                    Then::Stay => continue,
                    Then::Restart => {
                        Timer::after(LAST_WORDS).await;
                        cortex_m::peripheral::SCB::sys_reset()
                    }
                }
            }
            if let axes @ 1.. = about::now().axes {
                store.set_axes(axes);
            }
            store.answer(&request, async || Timer::after(PAUSE).await, &mut link).await;
        }
    }
}
