//! The kinds of features that a model reads, and how they are converted to inputs of its network.
//!
//! A blob contains the kind as a number (`recipe` in blob and wire), so that a board can refuse an unknown kind.
//! To add a kind, define it in [`FeatureKind::transform`] and give it the next number here.

use crate::right::network::FEATURES_PER_AXIS;

/// Smallest value that recipe 2 distinguishes from zero, in the squared unit of the axis.
pub const LOG_FLOOR: f32 = 1e-6;

/// The features that a model reads. Each kind transforms them before the affine scaling to int8.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FeatureKind {
    /// 1: the paper's features, unchanged.
    Raw,
    /// 2: RMS, variance and the eight powers become log10(value + [`LOG_FLOOR`]); other features are unchanged.
    LogPower,
    /// 3: the features of [`crate::right::aligned`], unchanged.
    Aligned,
}

impl FeatureKind {
    /// Returns the kind with this number in a blob.
    pub const fn from_id(id: u8) -> Option<Self> {
        match id {
            1 => Some(Self::Raw),
            2 => Some(Self::LogPower),
            3 => Some(Self::Aligned),
            _ => None,
        }
    }

    /// Returns the number of this kind in a blob.
    pub const fn id(self) -> u8 {
        match self {
            Self::Raw => 1,
            Self::LogPower => 2,
            Self::Aligned => 3,
        }
    }

    /// Number of features for samples with this number of axes; 0 if the kind does not support it.
    pub const fn feature_count(self, axes: usize) -> usize {
        match self {
            Self::Raw | Self::LogPower => FEATURES_PER_AXIS * axes,
            Self::Aligned => crate::right::aligned::feature_count(axes),
        }
    }

    /// A model for this number of axes reads this many values from the start of each sample.
    /// Recipe 3 reads no magnetometer.
    pub const fn reads(self, axes: usize) -> usize {
        match self {
            Self::Aligned if axes > 6 => 6,
            _ => axes,
        }
    }

    /// Returns whether a model for `model` axes can run on samples with `sample` axes.
    /// The samples must have all values that the model reads, and additional values must not change its features.
    /// (In recipe 3, a gyroscope changes the features of a window.)
    pub const fn runs_on(self, model: usize, sample: usize) -> bool {
        match self {
            Self::Raw | Self::LogPower => model <= sample,
            Self::Aligned => {
                crate::right::aligned::feature_count(model) == crate::right::aligned::feature_count(sample)
            }
        }
    }

    /// Converts a feature to a network input. `index` counts all features of a window, 13 per axis for recipes 1 and 2.
    pub fn transform(self, index: usize, value: f32) -> f32 {
        match self {
            Self::Raw | Self::Aligned => value,
            Self::LogPower => match index % FEATURES_PER_AXIS {
                1 | 2 | 5..=12 => log10(value + LOG_FLOOR),
                _ => value,
            },
        }
    }
}

/// Base-10 logarithm of a positive normal number. Its relative error is below 1e-6 of max(|log|, 1).
///
/// The logarithm uses only additions, products and one quotient in a fixed order, so the bits are equal on every target.
fn log10(x: f32) -> f32 {
    // The number is x = 2^exponent · mantissa, with the mantissa in [√½, √2).
    let bits = x.to_bits().wrapping_sub(0x3F35_04F3);
    let exponent = (bits as i32) >> 23;
    let mantissa = f32::from_bits((bits & 0x007F_FFFF).wrapping_add(0x3F35_04F3));
    // ln(m) = 2·atanh(t), t = (m − 1) / (m + 1), |t| ≤ 0.172.
    let t = (mantissa - 1.0) / (mantissa + 1.0);
    let t2 = t * t;
    const SCALE: f32 = 2.0 * core::f32::consts::LOG10_E;
    let series = 1.0 + t2 * (1.0 / 3.0 + t2 * (0.2 + t2 * (1.0 / 7.0 + t2 * (1.0 / 9.0))));
    exponent as f32 * core::f32::consts::LOG10_2 + SCALE * (t * series)
}

/// Natural logarithm of a positive normal number, computed in the same way as [`log10`].
pub(crate) fn ln(x: f32) -> f32 {
    core::f32::consts::LN_10 * log10(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logarithm_is_close_over_the_whole_range_of_powers() {
        let mut x = 1e-6f32;
        while x < 1e12 {
            let expected = f64::from(x).log10();
            let error = (f64::from(log10(x)) - expected).abs();
            assert!(error <= 1e-6 * expected.abs().max(1.0), "log10({x}): error {error:e}");
            x *= 1.003;
        }
    }

    #[test]
    fn a_model_runs_where_all_that_it_reads_is_there() {
        let runs = |recipe: FeatureKind| {
            [3, 6, 9].map(|model| [3, 6, 9].map(|sample| recipe.runs_on(model, sample)))
        };
        assert_eq!(runs(FeatureKind::Raw), [[true; 3], [false, true, true], [false, false, true]]);
        assert_eq!(
            runs(FeatureKind::Aligned),
            [[true, false, false], [false, true, true], [false, true, true]]
        );
        assert_eq!([FeatureKind::Aligned, FeatureKind::LogPower].map(|recipe| recipe.reads(9)), [6, 9]);
    }

    #[test]
    fn recipe_numbers_lead_there_and_back() {
        for id in 0..=255 {
            if let Some(recipe) = FeatureKind::from_id(id) {
                assert_eq!(recipe.id(), id);
            }
        }
        assert_eq!(FeatureKind::from_id(0), None);
        assert_eq!(FeatureKind::from_id(4), None);
    }
}
