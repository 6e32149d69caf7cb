//! REP-2016's hashes of the types used here, from Jazzy.
//! Types with the same name but different hashes are incompatible.
//! `tests/ros2/hashes.py` compares this table with Jazzy's own packages.

/// ROS types with their hashes. For an action, the table lists those of its parts that have their own topics.
const HASHES: [(&str, &str); 37] = [
    (
        "action_msgs/msg/GoalStatusArray",
        "RIHS01_6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e",
    ),
    ("action_msgs/srv/CancelGoal", "RIHS01_573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a"),
    (
        "action_msgs/srv/CancelGoal_Request",
        "RIHS01_3d3c84653c1f96918086887e1dcb236faec88b81a5b14fd4cf4840065bcdf8af",
    ),
    (
        "action_msgs/srv/CancelGoal_Response",
        "RIHS01_35e682cf3f510e83c70a82a4aac888496dedee56773bf9d8e5e0aa81f9e1c960",
    ),
    (
        "control_msgs/action/FollowJointTrajectory_FeedbackMessage",
        "RIHS01_80398fcb9674a79081a9906e2ccf0c804dd7cb15e22e362e606ee87186beab71",
    ),
    (
        "control_msgs/action/FollowJointTrajectory_GetResult",
        "RIHS01_e3ceb38e3e1867c8dc0f46014df26e90eb93422f27e9e97f936e07f94be4bc8b",
    ),
    (
        "control_msgs/action/FollowJointTrajectory_GetResult_Request",
        "RIHS01_ecf7ea8463d3beec7084bca75216d0b01b87b6e1e4e09679bb26093041efcbe9",
    ),
    (
        "control_msgs/action/FollowJointTrajectory_GetResult_Response",
        "RIHS01_08eefbaa146ce02ba45898d5e99160afd6c4c54a30d159aee0f2ca6035b1580f",
    ),
    (
        "control_msgs/action/FollowJointTrajectory_SendGoal",
        "RIHS01_b13789dddc325a7a962825c45e28c77d37237ec129dd0c34dc5994562938c57f",
    ),
    (
        "control_msgs/action/FollowJointTrajectory_SendGoal_Request",
        "RIHS01_179c93691f1f6d1d115881ff88c3917b7cc6eac2ba4bf56766cc7c4389e19ef1",
    ),
    (
        "control_msgs/action/FollowJointTrajectory_SendGoal_Response",
        "RIHS01_e6a48ba740ae254500129a877f0b071be8663a115da1a539b74599cc97921fbf",
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
        "control_msgs/action/GripperCommand_GetResult_Request",
        "RIHS01_1a3308da3acbc62cd8a3c823de80ba9e5f9b6bb6f6056d1ad6b29f5f285f97ae",
    ),
    (
        "control_msgs/action/GripperCommand_GetResult_Response",
        "RIHS01_32ed5e1b5906767a3e9914dca4c4aed22529918f6c2360e6fb382363d4df4b45",
    ),
    (
        "control_msgs/action/GripperCommand_SendGoal",
        "RIHS01_6bf8cc4ce80cd499e7dd3258c03c50c3fa6672b469ff8355339ef1df77fcd212",
    ),
    (
        "control_msgs/action/GripperCommand_SendGoal_Request",
        "RIHS01_1b869b7b4042272dc0f8ed65468c4e57c9e532ea5e53ce74fda0767eefbfa983",
    ),
    (
        "control_msgs/action/GripperCommand_SendGoal_Response",
        "RIHS01_0c8dda5e9d39ab5e3162b66e79b292a4258659ddfcf8722d39463f718b6c59bc",
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
        "control_msgs/action/ParallelGripperCommand_GetResult_Request",
        "RIHS01_cea82415cadc3288fdfa8aaba509e9939732aaecac6edf9cb954e5a7161646ec",
    ),
    (
        "control_msgs/action/ParallelGripperCommand_GetResult_Response",
        "RIHS01_c973b1bb9b454de1c3f38a2af9d45bc1930b809f746d6d6ec91bb3c783cb09eb",
    ),
    (
        "control_msgs/action/ParallelGripperCommand_SendGoal",
        "RIHS01_567c37373fed1260adbe047415688c73e4f3e94b2e3982761ecc71fd63d710a7",
    ),
    (
        "control_msgs/action/ParallelGripperCommand_SendGoal_Request",
        "RIHS01_dc8e5d95c0e15af6f03ff237eb8cfdaac14cc2b09f51b363311e98ec0a8487a0",
    ),
    (
        "control_msgs/action/ParallelGripperCommand_SendGoal_Response",
        "RIHS01_613e4f060bff03b152eeaba1f8c6baa9d0309527b28b08bc9aae28ece7ef8b47",
    ),
    (
        "control_msgs/msg/JointTrajectoryControllerState",
        "RIHS01_51d8dd89cc624cbe9daaeeb4d80d6de9b86168ffdc3be41fefc0953e3c26e480",
    ),
    (
        "diagnostic_msgs/msg/DiagnosticArray",
        "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    ),
    (
        "geometry_msgs/msg/PoseStamped",
        "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
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

/// Returns the hash of a type such as `geometry_msgs/msg/Twist`, or `None` if it is not used here.
pub fn of(ros_type: &str) -> Option<&'static str> {
    HASHES.iter().find(|(name, _)| *name == ros_type).map(|(_, hash)| *hash)
}
