//! The receiving task: hands the laptop's messages to the board and to the store of models, which answer them.

use embassy_time::{Duration, Timer};
use shared_board::models::{MappedFlash, ModelStore};
use shared_proto::frame::parse_host;
use shared_proto::message::HostMessage;

use crate::link::INBOX;
use crate::{about, board, state, vibrate};

/// After a page was erased, which stops the processor for 85 ms; the sensor's FIFO holds 134 ms.
const PAUSE: Duration = Duration::from_millis(40);

/// Answers for ever.
pub async fn run<F: MappedFlash>(mut store: ModelStore<F>) -> ! {
    loop {
        let received = INBOX.receive().await;
        let mut link = received.link;
        // What this version does not know it leaves unanswered; damage has been counted already.
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
