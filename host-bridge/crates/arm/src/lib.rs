//! The arm: its model, its planner and its director.
//!
//! * [`model`], [`gen3`], `urdf`: joints, limits, shapes and forward kinematics,
//! * [`ik`]: from a pose of the flange to joint angles,
//! * [`scene`], [`plan`]: the surroundings, and motions that touch nothing,
//! * [`tool`], [`things`]: tools on the flange, and objects to grip,
//! * [`motions`]: named motions and poses, as data,
//! * [`director`]: combines all of these between the bridge and any robot.

pub mod director;
pub mod gen3;
pub mod ik;
pub mod model;
pub mod motions;
pub mod plan;
pub mod scene;
pub mod things;
pub mod tool;
#[cfg(feature = "urdf")]
pub mod urdf;
#[cfg(feature = "urdf")]
mod urdf_numbers;
#[cfg(feature = "urdf")]
mod urdf_shapes;

pub use director::Director;
pub use motions::Motions;
