//! The ROS 2 messages that this program uses, with the same fields as in the Jazzy packages.
//! The program uses these messages over DDS, in session files and for Foxglove ([`crate::Topic`]).
//!
//! Arrays of 36 values are written as 6 × 6, which is the same on the wire.
//! [`crate::values`] creates them from the bridge's own values.

use crate::schema::messages;

messages! {
    /// `builtin_interfaces/Time`, also used for `Duration`.
    "builtin_interfaces/Time" Time: Copy, Eq {
        /// Seconds.
        sec: i32,
        /// Nanoseconds after the full second.
        nanosec: u32,
    }

    /// `std_msgs/Header`.
    "std_msgs/Header" Header {
        /// Wall clock.
        stamp: Time,
        /// Coordinate frame.
        frame_id: String,
    }

    /// `geometry_msgs/Vector3`.
    "geometry_msgs/Vector3" Vector3: Copy {
        /// Forward.
        x: f64,
        /// Left.
        y: f64,
        /// Up.
        z: f64,
    }

    /// `geometry_msgs/Point`.
    "geometry_msgs/Point" Point: Copy {
        /// Forward.
        x: f64,
        /// Left.
        y: f64,
        /// Up.
        z: f64,
    }

    /// `geometry_msgs/Quaternion`.
    "geometry_msgs/Quaternion" Quaternion: Copy {
        /// Along x.
        x: f64,
        /// Along y.
        y: f64,
        /// Along z.
        z: f64,
        /// Real part.
        w: f64,
    }

    /// `geometry_msgs/Twist`, m/s and rad/s.
    "geometry_msgs/Twist" Twist: Copy {
        /// m/s.
        linear: Vector3,
        /// rad/s.
        angular: Vector3,
    }

    /// `geometry_msgs/TwistStamped`.
    "geometry_msgs/TwistStamped" TwistStamped {
        /// Time of the decision, and the frame of the speed.
        header: Header,
        /// Speed.
        twist: Twist,
    }

    /// `geometry_msgs/Pose`.
    "geometry_msgs/Pose" Pose: Copy {
        /// m.
        position: Point,
        /// Unit quaternion.
        orientation: Quaternion,
    }

    /// `geometry_msgs/PoseStamped`.
    "geometry_msgs/PoseStamped" PoseStamped {
        /// The time of the measurement, and the frame of the pose.
        header: Header,
        /// Position and orientation.
        pose: Pose,
    }

    /// `geometry_msgs/PoseWithCovariance`.
    "geometry_msgs/PoseWithCovariance" PoseWithCovariance {
        /// Pose.
        pose: Pose,
        /// x, y, z, about x, about y, about z.
        covariance: [[f64; 6]; 6],
    }

    /// `geometry_msgs/TwistWithCovariance`.
    "geometry_msgs/TwistWithCovariance" TwistWithCovariance {
        /// Speed.
        twist: Twist,
        /// As for the pose.
        covariance: [[f64; 6]; 6],
    }

    /// `nav_msgs/Odometry`.
    "nav_msgs/Odometry" Odometry {
        /// Frame of the pose.
        header: Header,
        /// Frame of the speed.
        child_frame_id: String,
        /// Position of the base.
        pose: PoseWithCovariance,
        /// Speed of the base.
        twist: TwistWithCovariance,
    }

    /// `geometry_msgs/Transform`.
    "geometry_msgs/Transform" Transform: Copy {
        /// m.
        translation: Vector3,
        /// Unit quaternion.
        rotation: Quaternion,
    }

    /// `geometry_msgs/TransformStamped`.
    "geometry_msgs/TransformStamped" TransformStamped {
        /// Parent frame.
        header: Header,
        /// Child frame.
        child_frame_id: String,
        /// Child in parent.
        transform: Transform,
    }

    /// `tf2_msgs/TFMessage`.
    "tf2_msgs/TFMessage" TfMessage {
        /// All of them.
        transforms: Vec<TransformStamped>,
    }

    /// `sensor_msgs/JointState`.
    "sensor_msgs/JointState" JointState {
        /// When.
        header: Header,
        /// Joints in the order of the values.
        name: Vec<String>,
        /// rad.
        position: Vec<f64>,
        /// rad/s; may be empty.
        velocity: Vec<f64>,
        /// Nm; may be empty.
        effort: Vec<f64>,
    }

    /// `sensor_msgs/Imu`. A covariance that begins with -1 means that there is no such reading.
    "sensor_msgs/Imu" Imu {
        /// When, and of which part.
        header: Header,
        /// Unit quaternion.
        orientation: Quaternion,
        /// Row by row.
        orientation_covariance: [f64; 9],
        /// rad/s.
        angular_velocity: Vector3,
        /// Row by row.
        angular_velocity_covariance: [f64; 9],
        /// m/s².
        linear_acceleration: Vector3,
        /// Row by row.
        linear_acceleration_covariance: [f64; 9],
    }

    /// `sensor_msgs/MagneticField`.
    "sensor_msgs/MagneticField" MagneticField {
        /// When, and of which part.
        header: Header,
        /// Tesla.
        magnetic_field: Vector3,
        /// Row by row.
        magnetic_field_covariance: [f64; 9],
    }

    /// `rcl_interfaces/Log`.
    "rcl_interfaces/Log" Log {
        /// When.
        stamp: Time,
        /// 20 = information, 30 = warning.
        level: u8,
        /// Who says it.
        name: String,
        /// What.
        msg: String,
        /// Source file; empty here.
        file: String,
        /// Function; empty here.
        function: String,
        /// Line; 0 here.
        line: u32,
    }

    /// `trajectory_msgs/JointTrajectoryPoint`.
    "trajectory_msgs/JointTrajectoryPoint" JointTrajectoryPoint {
        /// rad.
        positions: Vec<f64>,
        /// rad/s.
        velocities: Vec<f64>,
        /// rad/s².
        accelerations: Vec<f64>,
        /// Nm.
        effort: Vec<f64>,
        /// Time since the start of the trajectory.
        time_from_start: Time,
    }

    /// `trajectory_msgs/JointTrajectory`. A stamp of zero means that the trajectory starts on arrival.
    "trajectory_msgs/JointTrajectory" JointTrajectory {
        /// Start.
        header: Header,
        /// Joints in the order of the values.
        joint_names: Vec<String>,
        /// Points in order of time; the arm rests at the last one.
        points: Vec<JointTrajectoryPoint>,
    }

    /// `trajectory_msgs/MultiDOFJointTrajectoryPoint`.
    "trajectory_msgs/MultiDOFJointTrajectoryPoint" MultiDofPoint {
        /// Poses.
        transforms: Vec<Transform>,
        /// Speeds.
        velocities: Vec<Twist>,
        /// Accelerations.
        accelerations: Vec<Twist>,
        /// Time since the start of the trajectory.
        time_from_start: Time,
    }

    /// `trajectory_msgs/MultiDOFJointTrajectory`; empty here.
    "trajectory_msgs/MultiDOFJointTrajectory" MultiDofTrajectory {
        /// Start.
        header: Header,
        /// Joints.
        joint_names: Vec<String>,
        /// Points.
        points: Vec<MultiDofPoint>,
    }

    /// `control_msgs/JointTolerance`.
    "control_msgs/JointTolerance" JointTolerance {
        /// Joint.
        name: String,
        /// rad.
        position: f64,
        /// rad/s.
        velocity: f64,
        /// rad/s².
        acceleration: f64,
    }

    /// `control_msgs/JointComponentTolerance`.
    "control_msgs/JointComponentTolerance" JointComponentTolerance {
        /// Joint.
        joint_name: String,
        /// Which of its components.
        component: u16,
        /// m or rad.
        position: f64,
        /// Per second.
        velocity: f64,
        /// Per second squared.
        acceleration: f64,
    }

    /// Goal of `control_msgs/action/FollowJointTrajectory`.
    /// Empty tolerances select the controller's own tolerances.
    "control_msgs/FollowJointTrajectory_Goal" FollowGoal {
        /// The motion.
        trajectory: JointTrajectory,
        /// Unused.
        multi_dof_trajectory: MultiDofTrajectory,
        /// Tolerances along the path.
        path_tolerance: Vec<JointTolerance>,
        /// Unused.
        component_path_tolerance: Vec<JointComponentTolerance>,
        /// Tolerances at the end.
        goal_tolerance: Vec<JointTolerance>,
        /// Unused.
        component_goal_tolerance: Vec<JointComponentTolerance>,
        /// Maximum delay of the end.
        goal_time_tolerance: Time,
    }

    /// Result of `control_msgs/action/FollowJointTrajectory`.
    "control_msgs/FollowJointTrajectory_Result" FollowResult {
        /// 0 = successful.
        error_code: i32,
        /// The text of the error.
        error_string: String,
    }

    /// Feedback of the same action. The later fields differ between releases, and are not read.
    "control_msgs/FollowJointTrajectory_Feedback" FollowFeedback {
        /// When.
        header: Header,
        /// Joints.
        joint_names: Vec<String>,
        /// The requested state of the arm.
        desired: JointTrajectoryPoint,
        /// The measured state of the arm.
        actual: JointTrajectoryPoint,
    }

    /// `std_msgs/String`.
    "std_msgs/String" Text: Eq {
        /// What.
        data: String,
    }

    /// `control_msgs/GripperCommand`, with a position in the gripper joint's own units.
    "control_msgs/GripperCommand" GripperCommand: Copy {
        /// In the joint's own units.
        position: f64,
        /// Maximum force; 0 selects the controller's default.
        max_effort: f64,
    }

    /// Goal of `control_msgs/action/GripperCommand`.
    "control_msgs/GripperCommand_Goal" GripGoal: Copy {
        /// The requested position and force.
        command: GripperCommand,
    }

    /// Result and feedback of `control_msgs/action/GripperCommand`.
    "control_msgs/GripperCommand_Result" GripResult: Copy {
        /// In the joint's own units.
        position: f64,
        /// The force.
        effort: f64,
        /// Whether something stops the fingers while they push.
        stalled: bool,
        /// Whether the requested position was reached.
        reached_goal: bool,
    }

    /// Goal of `control_msgs/action/ParallelGripperCommand`.
    "control_msgs/ParallelGripperCommand_Goal" ParallelGoal {
        /// One joint.
        command: JointState,
    }

    /// Result of `control_msgs/action/ParallelGripperCommand`.
    "control_msgs/ParallelGripperCommand_Result" ParallelResult {
        /// One joint.
        state: JointState,
        /// Whether something stops the fingers while they push.
        stalled: bool,
        /// Whether the requested position was reached.
        reached_goal: bool,
    }

    /// Feedback of `control_msgs/action/ParallelGripperCommand`.
    "control_msgs/ParallelGripperCommand_Feedback" ParallelFeedback {
        /// One joint.
        state: JointState,
    }

    /// `std_msgs/Bool`.
    "std_msgs/Bool" Bool: Copy, Eq {
        /// Yes or no.
        data: bool,
    }

    /// `diagnostic_msgs/KeyValue`.
    "diagnostic_msgs/KeyValue" KeyValue: Eq {
        /// Name.
        key: String,
        /// Text.
        value: String,
    }

    /// `diagnostic_msgs/DiagnosticStatus`.
    "diagnostic_msgs/DiagnosticStatus" DiagnosticStatus: Eq {
        /// One of the constants [`DiagnosticStatus::OK`] and so on.
        level: u8,
        /// `node: part`.
        name: String,
        /// The state in a few words.
        message: String,
        /// The board that is described.
        hardware_id: String,
        /// Details.
        values: Vec<KeyValue>,
    }

    /// `diagnostic_msgs/DiagnosticArray`.
    "diagnostic_msgs/DiagnosticArray" DiagnosticArray {
        /// When.
        header: Header,
        /// One per part.
        status: Vec<DiagnosticStatus>,
    }

    /// `rosgraph_msgs/Clock`: the time of a simulation.
    "rosgraph_msgs/Clock" Clock: Copy, Eq {
        /// Now.
        clock: Time,
    }

    /// `control_msgs/JointTrajectoryControllerState` up to the last field that is used.
    /// The later fields differ between releases, and are not read.
    "control_msgs/JointTrajectoryControllerState" ControllerState {
        /// When.
        header: Header,
        /// Joints.
        joint_names: Vec<String>,
        /// The controller's current set point for the arm.
        reference: JointTrajectoryPoint,
        /// The measured state of the arm.
        feedback: JointTrajectoryPoint,
    }
}
