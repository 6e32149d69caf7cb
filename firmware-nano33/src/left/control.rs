//! The receiving task passes the laptop's requests to the board and to the store of images, and writes the calibration to flash.

use embassy_futures::join::join;
use shared_board::eeprom_log::EepromLog;
use shared_board::images::ImageStore;
use shared_board::models::{MappedFlash, ModelRequest};
use shared_proto::frame::{parse_host, parse_left_request};
use shared_proto::message::LeftRequest;

use super::memory;
use crate::link::{INBOX, WayOut};
use crate::{board, radio, update};

/// Answers for ever.
pub async fn run<F: MappedFlash>(log: EepromLog<F>, images: ImageStore<impl MappedFlash>) -> ! {
    join(answer(images), memory::save(log)).await;
    unreachable!("both run for ever")
}

async fn answer(mut images: ImageStore<impl MappedFlash>) -> ! {
    loop {
        let received = INBOX.receive().await;
        let mut link = received.link;
        if !received.trusted {
            continue;
        }
        // Requests that a left hand does not know get no reply. Damaged frames were already counted.
        if let Ok(request) = parse_left_request(&received.payload) {
            board::with(|board| board.answer(request, &mut link));
            if request == LeftRequest::HelloRequest {
                // If the mark is not stored, the laptop's question about the image says so.
                images.said_hello().await;
                if link == WayOut::Ble {
                    radio::say_paired();
                }
            }
        } else if let Ok(message) = parse_host(&received.payload)
            && let Some(request) = ModelRequest::of(&message)
            && !update::answer(&mut images, &request, &mut link).await
        {
            // A left hand has no models.
            request.refuse(&mut link);
        }
    }
}
