//! One page that shows what a data set holds and how models do on it.

mod facts;
mod page;
mod pictures;
pub mod svg;

pub use facts::{Facts, PersonFacts, feature_names};
pub use page::html;

use crate::evaluate::study::{Events, Study};

/// Size of a network as a board holds it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NetworkSize {
    /// Inputs, then outputs of each layer.
    pub widths: Vec<usize>,
    /// Bytes of the blob: weights, scaling, tables and labels.
    pub blob_bytes: usize,
}

impl NetworkSize {
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
    /// What the data holds.
    pub facts: Facts,
    /// One per recipe.
    pub studies: Vec<Study>,
    /// Network of each recipe, in the same order.
    pub networks: Vec<NetworkSize>,
    /// Of the last recipe.
    pub events: Option<Events>,
    /// Per recipe and person: (share of the others' recordings, right recordings in per cent).
    pub learning: Vec<(String, Vec<(f64, f64)>)>,
}
