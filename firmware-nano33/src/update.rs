//! Answers the laptop's requests about a new image, and restarts the board when the image waits for its exchange.

use embassy_time::{Duration, Timer};
use shared_board::images::{ImageStore, Then};
use shared_board::models::{MappedFlash, ModelRequest};
use shared_board::update::Source;

use crate::link::WayOut;
use crate::storage::PAUSE;

/// Time in which the answer to the last piece of a new image reaches the laptop before the board restarts.
const LAST_WORDS: Duration = Duration::from_millis(300);

/// Answers a request about an image. Returns whether the request was about an image.
pub async fn answer(
    images: &mut ImageStore<impl MappedFlash>,
    request: &ModelRequest<'_>,
    link: &mut WayOut,
) -> bool {
    let source = if *link == WayOut::Ble { Source::Air } else { Source::Cable };
    match images.answer(request, source, async || Timer::after(PAUSE).await, link).await {
        Then::Pass => false,
        Then::Stay => true,
        Then::Restart => {
            Timer::after(LAST_WORDS).await;
            cortex_m::peripheral::SCB::sys_reset()
        }
    }
}
