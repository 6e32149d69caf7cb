//! Constants for the Fourier transform.

/// One half of the 25-point Hann window without its centre, which is ½ + ½·cos(2πm/26) for m = 1 to 12.
pub(super) const HANN: [f32; 12] = [
    0.985_470_9,
    0.942_728,
    0.874_255_36,
    0.784_032_4,
    0.677_302_4,
    0.560_268_34,
    0.439_731_66,
    0.322_697_55,
    0.215_967_63,
    0.125_744_63,
    0.057_271_987,
    0.014_529_091,
];

/// cos(2πm/32), m = 0 to 7.
pub(super) const COSINES: [f32; 8] = [
    1.0,
    0.980_785_25,
    0.923_879_5,
    0.831_469_6,
    core::f32::consts::FRAC_1_SQRT_2,
    0.555_570_24,
    0.382_683_43,
    0.195_090_32,
];
