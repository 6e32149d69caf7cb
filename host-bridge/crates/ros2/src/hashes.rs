//! REP-2016's hashes of the types that are spoken here, as Jazzy has them: two ends whose types have one name and two
//! hashes do not mean the same. `tests/ros2/hashes.py` holds the table against Jazzy's own packages.

/// ROS type, and its hash. Of an action the parts that have topics of their own.
const HASHES: [(&str, &str); 22] = [
    (
        "action_msgs/msg/GoalStatusArray",
        "RIHS01_6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e",
    ),
    ("action_msgs/srv/CancelGoal", "RIHS01_573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a"),
    (
        "control_msgs/action/FollowJointTrajectory_FeedbackMessage",
        "RIHS01_80398fcb9674a79081a9906e2ccf0c804dd7cb15e22e362e606ee87186beab71",
    ),
    (
        "control_msgs/action/FollowJointTrajectory_GetResult",
        "RIHS01_e3ceb38e3e1867c8dc0f46014df26e90eb93422f27e9e97f936e07f94be4bc8b",
    ),
    (
        "control_msgs/action/FollowJointTrajectory_SendGoal",
        "RIHS01_b13789dddc325a7a962825c45e28c77d37237ec129dd0c34dc5994562938c57f",
    ),
    (
        "control_msgs/action/GripperCommand_FeedbackMessage",
        "RIHS01_392ff03fcd872f9dc2405cbeb2897fcf011ad9998458b6aa85c603b8a49e431d",
    ),
    (
        "control_msgs/action/GripperCommand_GetResult",
        "RIHS01_7e60a7606063d4a2728d21badac099e68b734a196ac3ab42d1d4c668eb0bb3cd",
    ),
    (
        "control_msgs/action/GripperCommand_SendGoal",
        "RIHS01_6bf8cc4ce80cd499e7dd3258c03c50c3fa6672b469ff8355339ef1df77fcd212",
    ),
    (
        "control_msgs/action/ParallelGripperCommand_FeedbackMessage",
        "RIHS01_c61f4cf99d06c5a3e24bed17c2910bdf66a30d89461e2ac7b5fd538a34b022cc",
    ),
    (
        "control_msgs/action/ParallelGripperCommand_GetResult",
        "RIHS01_e4c7f0e8a831ce5625ed20abcd13796406d945f92ebc7ad5972e0b0d29b381bd",
    ),
    (
        "control_msgs/action/ParallelGripperCommand_SendGoal",
        "RIHS01_567c37373fed1260adbe047415688c73e4f3e94b2e3982761ecc71fd63d710a7",
    ),
    (
        "control_msgs/msg/JointTrajectoryControllerState",
        "RIHS01_51d8dd89cc624cbe9daaeeb4d80d6de9b86168ffdc3be41fefc0953e3c26e480",
    ),
    (
        "diagnostic_msgs/msg/DiagnosticArray",
        "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    ),
    ("geometry_msgs/msg/Twist", "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"),
    (
        "geometry_msgs/msg/TwistStamped",
        "RIHS01_5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
    ),
    ("nav_msgs/msg/Odometry", "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"),
    ("rosgraph_msgs/msg/Clock", "RIHS01_692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564"),
    ("sensor_msgs/msg/JointState", "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"),
    ("std_msgs/msg/Bool", "RIHS01_feb91e995ff9ebd09c0cb3d2aed18b11077585839fb5db80193b62d74528f6c9"),
    ("std_msgs/msg/String", "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"),
    ("tf2_msgs/msg/TFMessage", "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"),
    (
        "trajectory_msgs/msg/JointTrajectory",
        "RIHS01_179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e",
    ),
];

/// The hash of a type such as `geometry_msgs/msg/Twist`; `None` for one that is not spoken here.
pub fn of(ros_type: &str) -> Option<&'static str> {
    // An end point of a service has the service's hash.
    let service = ros_type.strip_suffix("_Request").or_else(|| ros_type.strip_suffix("_Response"));
    let known = service.unwrap_or(ros_type);
    HASHES.iter().find(|(name, _)| *name == known).map(|(_, hash)| *hash)
}
