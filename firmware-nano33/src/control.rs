//! The receiving task: answers the laptop.

use core::sync::atomic::Ordering;

use shared_dsp::mlp::Model;
use shared_proto::frame::parse_host;
use shared_proto::message::{
    Ack, AckResult, Board, BoardMessage, Hello, HostMessage, ModelInfo, PROTOCOL_MAJOR, PROTOCOL_MINOR, Pong,
};

use crate::link::{INBOX, Link};
use crate::sample::SAMPLE_HZ;
use crate::state;
use crate::storage::Flash;
use crate::transfer::Transfer;

/// Says who this board is and what its model names.
pub fn hello(link: Link, model: &Model<'static>) {
    let info = model.info();
    let rev2 = state::REV2.load(Ordering::Relaxed);
    link.send(&BoardMessage::Hello(Hello {
        major: PROTOCOL_MAJOR,
        minor: PROTOCOL_MINOR,
        board: if rev2 { Board::RightNano33Rev2 } else { Board::RightNano33 },
        firmware: env!("CARGO_PKG_VERSION"),
        boot_id: state::BOOT_ID.load(Ordering::Relaxed),
        model_id: info.model_id,
        sample_hz: SAMPLE_HZ as u16,
    }));
    link.send(&BoardMessage::ModelInfo(ModelInfo {
        model_id: info.model_id,
        recipe: info.recipe.id(),
        axes: info.axes as u8,
        sample_hz: info.sample_hz,
        window: info.window,
        labels: info.label_text,
    }));
    state::repeat_faults(link);
}

/// Answers for ever.
pub async fn run<F: Flash>(model: &'static Model<'static>, mut transfer: Transfer<F>) -> ! {
    loop {
        let received = INBOX.receive().await;
        let link = received.link;
        // What this version does not know it leaves unanswered; damage has been counted already.
        let Ok(message) = parse_host(&received.payload) else { continue };
        let ack = |request, result| BoardMessage::Ack(Ack { request, result, next_offset: 0 });
        match message {
            HostMessage::HelloRequest => hello(link, model),
            HostMessage::Ping { id } => {
                link.send(&BoardMessage::Pong(Pong { id, board_time_ms: state::now_ms() }));
            }
            HostMessage::SetMode { request, .. } if !received.trusted => {
                link.send(&ack(request, AckResult::NotBonded));
            }
            HostMessage::SetMode { request, mode } => {
                state::set_mode(mode);
                link.send(&ack(request, AckResult::Ok));
            }
            HostMessage::Calibrate { request, .. } | HostMessage::SetThresholds { request, .. } => {
                link.send(&ack(request, AckResult::Unsupported));
            }
            HostMessage::ModelBegin(begin) if !received.trusted => {
                link.send(&ack(begin.request, AckResult::NotBonded));
            }
            HostMessage::ModelChunk { request, .. } | HostMessage::ModelCommit { request, .. }
                if !received.trusted =>
            {
                link.send(&ack(request, AckResult::NotBonded));
            }
            HostMessage::ModelBegin(begin) => transfer.begin(link, &begin).await,
            HostMessage::ModelChunk { request, offset, data } => {
                let answer = transfer.chunk(request, offset, data).await;
                link.send(&answer);
            }
            HostMessage::ModelCommit { request, crc32 } => {
                let answer = transfer.commit(request, crc32).await;
                link.send(&answer);
            }
        }
    }
}
