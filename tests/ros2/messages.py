"""The messages of ROS 2 Jazzy as Cyclone DDS sees them on the wire, written from the packages' definitions.

Shares nothing with the Rust side: what both understand, they understand by the standard.
"""

from dataclasses import dataclass

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int8, int32, int64, sequence, uint8, uint16, uint32


def _name(package, kind, name):
    return f"{package}.{kind}.dds_.{name}_"


@dataclass
class Time(IdlStruct, typename=_name("builtin_interfaces", "msg", "Time")):
    sec: int32 = 0
    nanosec: uint32 = 0

    def seconds(self):
        return self.sec + self.nanosec * 1e-9

    @staticmethod
    def of(seconds):
        return Time(int(seconds), int((seconds - int(seconds)) * 1e9))


@dataclass
class Duration(IdlStruct, typename=_name("builtin_interfaces", "msg", "Duration")):
    sec: int32 = 0
    nanosec: uint32 = 0

    def seconds(self):
        return self.sec + self.nanosec * 1e-9


@dataclass
class Header(IdlStruct, typename=_name("std_msgs", "msg", "Header")):
    stamp: Time
    frame_id: str = ""


@dataclass
class Vector3(IdlStruct, typename=_name("geometry_msgs", "msg", "Vector3")):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Point(IdlStruct, typename=_name("geometry_msgs", "msg", "Point")):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Quaternion(IdlStruct, typename=_name("geometry_msgs", "msg", "Quaternion")):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0


@dataclass
class Twist(IdlStruct, typename=_name("geometry_msgs", "msg", "Twist")):
    linear: Vector3
    angular: Vector3


@dataclass
class TwistStamped(IdlStruct, typename=_name("geometry_msgs", "msg", "TwistStamped")):
    header: Header
    twist: Twist


@dataclass
class Pose(IdlStruct, typename=_name("geometry_msgs", "msg", "Pose")):
    position: Point
    orientation: Quaternion


@dataclass
class PoseWithCovariance(IdlStruct, typename=_name("geometry_msgs", "msg", "PoseWithCovariance")):
    pose: Pose
    covariance: array[float64, 36]


@dataclass
class TwistWithCovariance(IdlStruct, typename=_name("geometry_msgs", "msg", "TwistWithCovariance")):
    twist: Twist
    covariance: array[float64, 36]


@dataclass
class Odometry(IdlStruct, typename=_name("nav_msgs", "msg", "Odometry")):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass
class Transform(IdlStruct, typename=_name("geometry_msgs", "msg", "Transform")):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename=_name("geometry_msgs", "msg", "TransformStamped")):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename=_name("tf2_msgs", "msg", "TFMessage")):
    transforms: sequence[TransformStamped]


@dataclass
class JointState(IdlStruct, typename=_name("sensor_msgs", "msg", "JointState")):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@dataclass
class JointTrajectoryPoint(IdlStruct, typename=_name("trajectory_msgs", "msg", "JointTrajectoryPoint")):
    positions: sequence[float64]
    velocities: sequence[float64]
    accelerations: sequence[float64]
    effort: sequence[float64]
    time_from_start: Duration


@dataclass
class JointTrajectory(IdlStruct, typename=_name("trajectory_msgs", "msg", "JointTrajectory")):
    header: Header
    joint_names: sequence[str]
    points: sequence[JointTrajectoryPoint]


@dataclass
class MultiDOFJointTrajectoryPoint(
    IdlStruct, typename=_name("trajectory_msgs", "msg", "MultiDOFJointTrajectoryPoint")
):
    transforms: sequence[Transform]
    velocities: sequence[Twist]
    accelerations: sequence[Twist]
    time_from_start: Duration


@dataclass
class MultiDOFJointTrajectory(IdlStruct, typename=_name("trajectory_msgs", "msg", "MultiDOFJointTrajectory")):
    header: Header
    joint_names: sequence[str]
    points: sequence[MultiDOFJointTrajectoryPoint]


@dataclass
class JointTolerance(IdlStruct, typename=_name("control_msgs", "msg", "JointTolerance")):
    name: str
    position: float64
    velocity: float64
    acceleration: float64


@dataclass
class JointComponentTolerance(IdlStruct, typename=_name("control_msgs", "msg", "JointComponentTolerance")):
    joint_name: str
    component: uint16
    position: float64
    velocity: float64
    acceleration: float64


@dataclass
class KeyValue(IdlStruct, typename=_name("diagnostic_msgs", "msg", "KeyValue")):
    key: str
    value: str


@dataclass
class DiagnosticStatus(IdlStruct, typename=_name("diagnostic_msgs", "msg", "DiagnosticStatus")):
    level: uint8
    name: str
    message: str
    hardware_id: str
    values: sequence[KeyValue]


@dataclass
class DiagnosticArray(IdlStruct, typename=_name("diagnostic_msgs", "msg", "DiagnosticArray")):
    header: Header
    status: sequence[DiagnosticStatus]


# What follows is an action, as rmw_cyclonedds_cpp puts it on the wire: requests and replies begin with the
# client's identity and a number, which a reply repeats.


@dataclass
class Request(IdlStruct, typename="bimanual.Request"):
    client: array[uint8, 8]
    number: int64


@dataclass
class FollowGoal(IdlStruct, typename=_name("control_msgs", "action", "FollowJointTrajectory_Goal")):
    trajectory: JointTrajectory
    multi_dof_trajectory: MultiDOFJointTrajectory
    path_tolerance: sequence[JointTolerance]
    component_path_tolerance: sequence[JointComponentTolerance]
    goal_tolerance: sequence[JointTolerance]
    component_goal_tolerance: sequence[JointComponentTolerance]
    goal_time_tolerance: Duration


@dataclass
class SendGoalRequest(
    IdlStruct, typename=_name("control_msgs", "action", "FollowJointTrajectory_SendGoal_Request")
):
    request: Request
    goal_id: array[uint8, 16]
    goal: FollowGoal


@dataclass
class SendGoalReply(
    IdlStruct, typename=_name("control_msgs", "action", "FollowJointTrajectory_SendGoal_Response")
):
    request: Request
    accepted: bool
    stamp: Time


@dataclass
class GoalInfo(IdlStruct, typename=_name("action_msgs", "msg", "GoalInfo")):
    goal_id: array[uint8, 16]
    stamp: Time


@dataclass
class CancelRequest(IdlStruct, typename=_name("action_msgs", "srv", "CancelGoal_Request")):
    request: Request
    goal_info: GoalInfo


@dataclass
class CancelReply(IdlStruct, typename=_name("action_msgs", "srv", "CancelGoal_Response")):
    request: Request
    return_code: int8
    goals_canceling: sequence[GoalInfo]


@dataclass
class ResultRequest(
    IdlStruct, typename=_name("control_msgs", "action", "FollowJointTrajectory_GetResult_Request")
):
    request: Request
    goal_id: array[uint8, 16]


@dataclass
class FollowResult(IdlStruct, typename=_name("control_msgs", "action", "FollowJointTrajectory_Result")):
    error_code: int32
    error_string: str


@dataclass
class ResultReply(
    IdlStruct, typename=_name("control_msgs", "action", "FollowJointTrajectory_GetResult_Response")
):
    request: Request
    status: int8
    result: FollowResult


@dataclass
class FollowFeedback(IdlStruct, typename=_name("control_msgs", "action", "FollowJointTrajectory_Feedback")):
    header: Header
    joint_names: sequence[str]
    desired: JointTrajectoryPoint
    actual: JointTrajectoryPoint
    error: JointTrajectoryPoint
    multi_dof_joint_names: sequence[str]
    multi_dof_desired: MultiDOFJointTrajectoryPoint
    multi_dof_actual: MultiDOFJointTrajectoryPoint
    multi_dof_error: MultiDOFJointTrajectoryPoint


@dataclass
class FeedbackMessage(
    IdlStruct, typename=_name("control_msgs", "action", "FollowJointTrajectory_FeedbackMessage")
):
    goal_id: array[uint8, 16]
    feedback: FollowFeedback
