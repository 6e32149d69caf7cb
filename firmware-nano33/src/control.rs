//! The receiving task passes the laptop's messages to the board and to the model store.
//! The board and the store reply to these messages.

use embassy_time::{Duration, Timer};
use shared_board::models::{MappedFlash, ModelStore};
use shared_proto::frame::parse_host;
use shared_proto::message::HostMessage;

use crate::link::INBOX;
use crate::{about, board, state, vibrate};

/// Pause after the erasure of a page, during which the processor stops for 85 ms. The sensor's FIFO holds 134 ms.
const PAUSE: Duration = Duration::from_millis(40);

/// Answers for ever.
pub async fn run<F: MappedFlash>(mut store: ModelStore<F>) -> ! {
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
        if let Some(request) = request {
            if let axes @ 1.. = about::now().axes {
                store.set_axes(axes);
            }
            store.answer(&request, async || Timer::after(PAUSE).await, &mut link).await;
        }
    }
}
