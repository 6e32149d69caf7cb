//! What the bridge needs of a robot, simulated or real.

use crate::arm::ArmMotion;
use crate::arm::sequencer::{ArmReport, ArmState, NotStarted};
use crate::base::{Odometry, Twist};

/// A base and an arm. Implementations stop by themselves when commands cease to come.
pub trait Robot {
    /// Sets the base's speed. Also tells the robot that the bridge is alive.
    fn drive(&mut self, twist: Twist);

    /// Starts an arm motion.
    ///
    /// # Errors
    /// [`NotStarted`] while another one runs, or where there is no safe way.
    fn start_motion(&mut self, motion: ArmMotion) -> Result<(), NotStarted>;

    /// Brings base and arm to rest within their limits; targets are forgotten.
    fn halt(&mut self);

    /// The arm as far as known.
    fn arm(&self) -> ArmState;

    /// The base as far as known.
    fn odometry(&self) -> Odometry;

    /// How the last arm motion ended; once per motion.
    fn take_arm_report(&mut self) -> Option<ArmReport>;
}
