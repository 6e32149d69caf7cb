//! Which model runs: the newest received one that is intact and fits, else the compiled-in one.

use shared_dsp::mlp::Model;
use shared_proto::message::FaultKind;
use static_cell::StaticCell;

use crate::storage::{self, Flash, Store};
use crate::{classify, state};

/// At a multiple of 4 bytes the network runs about three times as fast.
#[repr(C, align(4))]
struct Aligned<T: ?Sized>(T);

static BUNDLED: &Aligned<[u8]> = &Aligned(*include_bytes!(concat!(env!("OUT_DIR"), "/model.blob")));

/// The model to run, and the store for the next one.
pub fn choose<F: Flash>(flash: F) -> (&'static Model<'static>, Store<F>) {
    static MODEL: StaticCell<Model<'static>> = StaticCell::new();
    let found = storage::find(classify::fits);
    if found.damaged {
        state::report(FaultKind::ModelDamaged, 0);
    }
    let (slot, blob) = match found.model {
        Some((slot, blob)) => (Some(slot), blob),
        None => (None, &BUNDLED.0),
    };
    let model = match Model::parse(blob) {
        Ok(model) => model,
        // `find` has parsed a stored one; the bundled one is checked by build.rs.
        Err(_) => defmt::unreachable!("checked before"),
    };
    defmt::info!("model {:#010x}, from slot {}", model.info().model_id, slot);
    (MODEL.init(model), Store::new(flash, slot))
}
