//! Writes a page with the contents of a data set and the results of models.

mod facts;
mod page;
mod pictures;
pub mod svg;

pub use facts::{Facts, PersonFacts, feature_names};
pub use page::html;

use crate::evaluate::study::{Events, Study};
use crate::train::{TrainError, Trained};

/// Size of a network on a board.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NetworkSize {
    /// Number of inputs, followed by the number of outputs of each layer.
    pub widths: Vec<usize>,
    /// Size of the blob in bytes, including weights, scaling, tables and labels.
    pub blob_bytes: usize,
}

impl NetworkSize {
    /// Of a trained model.
    ///
    /// # Errors
    /// Fails if the weights cannot be converted to a blob.
    pub fn of(model: &Trained) -> Result<Self, TrainError> {
        let outputs = model.float.iter().map(|layer| layer.biases.len());
        let widths = std::iter::once(model.card.scaling.mean.len()).chain(outputs).collect();
        Ok(Self { widths, blob_bytes: model.blob()?.len() })
    }

    /// As in `117-20-10-5-7`.
    pub fn shape(&self) -> String {
        self.widths.iter().map(usize::to_string).collect::<Vec<_>>().join("-")
    }

    /// Multiplications per inference.
    pub fn products(&self) -> usize {
        self.widths.windows(2).map(|pair| pair[0] * pair[1]).sum()
    }
}

/// Everything on the page.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// Its title.
    pub title: String,
    /// Seeds per figure.
    pub seeds: u64,
    /// The contents of the data set.
    pub facts: Facts,
    /// One per recipe.
    pub studies: Vec<Study>,
    /// The network of each recipe, in the same order.
    pub networks: Vec<NetworkSize>,
    /// Of the last recipe.
    pub events: Option<Events>,
    /// Learning curves by recipe and person. Each point is (fraction of the other people's recordings, accuracy in per cent).
    pub learning: Vec<(String, Vec<(f64, f64)>)>,
}
