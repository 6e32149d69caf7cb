//! The arm: its model, its planner and its director.
//!
//! * [`model`], [`gen3`], [`solid`], `urdf`: joints, limits, shapes and forward kinematics,
//! * [`ik`]: the step from a pose of the flange to joint angles,
//! * [`scene`], [`plan`]: the surroundings, and motions without collisions,
//! * [`tool`], [`things`]: the tools on the flange, and the objects that a gripper can hold,
//! * [`motions`]: named motions and poses, as data,
//! * [`director`]: the part between bridge and robot, which combines all of these.

#[cfg(feature = "urdf")]
mod dae;
pub mod director;
pub mod frame;
pub mod gen3;
#[cfg(feature = "urdf")]
mod hull;
pub mod ik;
pub mod jog;
#[cfg(feature = "urdf")]
mod mesh;
pub mod model;
pub mod motions;
pub mod plan;
pub mod scene;
pub mod solid;
pub mod things;
pub mod tool;
#[cfg(feature = "urdf")]
pub mod urdf;
#[cfg(feature = "urdf")]
pub mod urdf_meshes;
#[cfg(feature = "urdf")]
mod urdf_numbers;
#[cfg(feature = "urdf")]
mod urdf_shapes;

pub use director::Director;
pub use motions::Motions;
