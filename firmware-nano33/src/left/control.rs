//! The receiving task passes the laptop's requests to the board, and writes its calibration to flash.

use embassy_futures::join::join;
use shared_board::eeprom_log::EepromLog;
use shared_board::models::MappedFlash;
use shared_proto::frame::parse_left_request;

use super::memory;
use crate::board;
use crate::link::INBOX;

/// Answers for ever.
pub async fn run<F: MappedFlash>(log: EepromLog<F>) -> ! {
    join(answer(), memory::save(log)).await;
    unreachable!("both run for ever")
}

async fn answer() -> ! {
    loop {
        let received = INBOX.receive().await;
        let mut link = received.link;
        // Requests that a left hand does not know get no reply. Damaged frames were already counted.
        if let Ok(request) = parse_left_request(&received.payload)
            && received.trusted
        {
            board::with(|board| board.answer(request, &mut link));
        }
    }
}
