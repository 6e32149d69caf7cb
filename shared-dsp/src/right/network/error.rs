//! Errors that explain why a model is refused.

use core::fmt;

use super::{BLOB_VERSION, BLOB_VERSION_PER_ROW};

/// The reason why a blob is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ModelError {
    /// The blob is shorter than its contents.
    Truncated,
    /// The blob does not start with `BMLP`, so it is not a model.
    NotAModel,
    /// The blob has another format version. The matching `models` tool must build it again.
    Version(u8),
    /// This image does not support the recipe.
    Recipe(u8),
    /// A number in the header is out of range or contradicts another number.
    Header,
    /// A scaling factor is not finite.
    Scaling {
        /// Index of the feature.
        feature: usize,
    },
    /// A layer's size, multiplier or shift is out of range, or the layer does not fit the previous layer.
    Layer {
        /// Index of the layer.
        layer: usize,
    },
    /// The table of exponentials does not start at 1 or does not decrease.
    ExponentialTable,
    /// The labels are empty or not printable ASCII, or their number is wrong.
    Labels,
}

impl fmt::Display for ModelError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Truncated => f.write_str("the model blob is cut short: copy it again"),
            Self::NotAModel => f.write_str("this is no model blob (it does not start with BMLP)"),
            Self::Version(version) => write!(
                f,
                "the model blob has format {version}, this program reads {BLOB_VERSION} and {BLOB_VERSION_PER_ROW}: make it anew \
                 with `models`"
            ),
            Self::Recipe(recipe) => {
                write!(
                    f,
                    "the model needs feature recipe {recipe}, which this program does not know: update it"
                )
            }
            Self::Header => f.write_str("a size in the model blob's header is out of range"),
            Self::Scaling { feature } => write!(f, "the scaling of feature {feature} is not a finite number"),
            Self::Layer { layer } => {
                write!(f, "layer {layer} of the model has a size, multiplier or shift out of range")
            }
            Self::ExponentialTable => f.write_str("the model blob's softmax table is damaged"),
            Self::Labels => f.write_str("the model blob's labels are damaged"),
        }
    }
}

impl core::error::Error for ModelError {}

/// The length of a slice differs from what the model requires.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WrongLength;

impl fmt::Display for WrongLength {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the number of inputs or scores is not the model's")
    }
}

impl core::error::Error for WrongLength {}
