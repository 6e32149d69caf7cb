//! The classification task passes samples to the board's logic.
//! Depending on the mode, the logic classifies gestures or builds raw batches.

use embassy_time::{Duration, with_timeout};
use shared_board::right::SILENCE_MS;

use crate::board::{self, Board};
use crate::link::Everywhere;
use crate::sample::{AXES, SAMPLES, Taken};
use crate::state::{self, ALIVE_CLASSIFY};

/// Passes one sample to the board. Tests inspect the arguments of this function and count its instructions.
#[inline(never)]
#[unsafe(no_mangle)]
extern "C" fn bimanual_sample(counts: &[i16; AXES], board: &mut Board, time_ms: u32, number: u32) -> bool {
    board.sample(counts, time_ms, number)
}

/// Takes samples for ever.
#[embassy_executor::task]
pub async fn run() -> ! {
    loop {
        let taken = with_timeout(Duration::from_millis(SILENCE_MS.into()), SAMPLES.receive()).await;
        state::alive(ALIVE_CLASSIFY);
        board::with(|board| match taken {
            Ok(Taken::Sample(sample)) => {
                if bimanual_sample(&sample.counts, board, sample.board_time_ms, sample.number) {
                    board.send_due(&mut Everywhere);
                }
            }
            Ok(Taken::Gap) => board.gap(),
            Err(_) => board.silence(&mut Everywhere),
        });
    }
}
