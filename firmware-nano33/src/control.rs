//! The receiving task passes the laptop's messages to the board and to the model store.
//! The board and the store reply to these messages.

use embassy_time::Timer;
#[cfg(feature = "trouble")]
use shared_board::images::ImageStore;
use shared_board::models::{MappedFlash, ModelStore};
use shared_proto::frame::parse_host;
use shared_proto::message::HostMessage;

use crate::link::INBOX;
#[cfg(feature = "trouble")]
use crate::link::WayOut;
use crate::storage::PAUSE;
use crate::{about, board, state, vibrate};
#[cfg(feature = "trouble")]
use crate::{radio, update};

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
            if link == WayOut::Ble {
                radio::say_paired();
            }
        }
        if let Some(request) = request {
            #[cfg(feature = "trouble")]
            if update::answer(&mut images, &request, &mut link).await {
                continue;
            }
            if let axes @ 1.. = about::now().axes {
                store.set_axes(axes);
            }
            store.answer(&request, async || Timer::after(PAUSE).await, &mut link).await;
        }
    }
}
