//! Thirteen features per axis of a sliding window, renewed every hop.

/// Samples per window.
pub const WINDOW: usize = 200;
/// Samples per hop.
pub const HOP: usize = 8;

/// A window over samples of `A` axes. (To come: this is the interface.)
pub struct FeatureWindow<const A: usize> {
    features: [[f32; 13]; A],
}

impl<const A: usize> FeatureWindow<A> {
    /// An empty window.
    pub const fn new() -> Self {
        Self { features: [[0.0; 13]; A] }
    }
    /// Takes a sample; true when a hop is complete and the window is full: then [`Self::features`] are new.
    pub fn push(&mut self, _sample: &[f32; A]) -> bool {
        false
    }
    /// Features of the window at the last complete hop.
    pub fn features(&self) -> &[[f32; 13]; A] {
        &self.features
    }
    /// Forgets all samples.
    pub fn reset(&mut self) {
        *self = Self::new();
    }
}

impl<const A: usize> Default for FeatureWindow<A> {
    fn default() -> Self {
        Self::new()
    }
}
