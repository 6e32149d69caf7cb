//! The arm: a Kinova Gen3 with seven joints.
//!
//! * [`gen3`]: its figures and forward kinematics,
//! * [`model`]: any serial arm, with the shapes of its links; the Gen3 is one,
//! * [`ik`]: joint angles for a place,
//! * `urdf`: other arms from their files (feature `urdf`),
//! * [`profile`]: limits and positions of joints,
//! * [`motions`]: the six named motions and the poses they end in,
//! * [`sequencer`]: one motion at a time, through home or as planned (see [`crate::plan`]).

pub mod gen3;
pub mod ik;
pub mod model;
pub mod motions;
pub mod profile;
pub mod sequencer;
#[cfg(feature = "urdf")]
pub mod urdf;

pub use gen3::{JOINTS, Joints, Pose};
pub use motions::ArmMotion;
pub use sequencer::{ArmState, Sequencer};
