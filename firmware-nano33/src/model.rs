//! Selects the model to run: the newest received model that is intact and compatible, otherwise the built-in model.

use core::sync::atomic::Ordering;

use shared_board::Identity;
use shared_board::hand::CountHand;
use shared_board::models::ModelStore;
use shared_dsp::right::decision::DecisionConfig;
use shared_dsp::right::network::Model;
use shared_dsp::right::{RightHand, Windows};
use shared_proto::message::{FaultKind, Sensor};
use static_cell::ConstStaticCell;

use crate::board::{self, Board, RUNS};
use crate::sample::{AXES, SAMPLE_HZ};
use crate::storage::{self, Flash, Region, Slots};
use crate::{boards, state};

/// With an alignment of 4 bytes the network runs about three times as fast.
#[repr(C, align(4))]
struct Aligned<T: ?Sized>(T);

static BUNDLED: &Aligned<[u8]> = &Aligned(*include_bytes!(concat!(env!("OUT_DIR"), "/model.blob")));

static WINDOWS: ConstStaticCell<Windows<AXES>> = ConstStaticCell::new(Windows::new());

/// The store for received models.
pub type Kept<F> = ModelStore<Slots<F>>;

/// Creates the board with the model to run, and returns the store for received models.
pub fn install<F: Flash>(flash: F) -> Kept<F> {
    let (store, found) = ModelStore::open(Region(flash), RUNS);
    let blob = found.model.map_or(&BUNDLED.0, storage::blob);
    // The store has checked a stored model, and build.rs checks the built-in model.
    let hand = Model::parse(blob).ok().and_then(|model| {
        RightHand::with_windows(model, DecisionConfig::default(), WINDOWS.try_take()?).ok()
    });
    let Some(hand) = hand else { defmt::unreachable!("checked before") };
    defmt::info!("model {:#010x}, from {}", hand.model().info().model_id, defmt::Debug2Format(&found.model));
    let identity = Identity {
        board: boards::kind(Sensor::None),
        firmware: env!("CARGO_PKG_VERSION"),
        boot_id: state::BOOT_ID.load(Ordering::Relaxed),
        sample_hz: SAMPLE_HZ as u16,
    };
    board::install(Board::new(identity, CountHand::new(hand, nano33_sensor::SCALE)));
    if found.damaged {
        state::report(FaultKind::ModelDamaged, 0);
    }
    store
}
