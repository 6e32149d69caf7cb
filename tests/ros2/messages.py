"""The messages of ROS 2 Jazzy as Cyclone DDS sees them on the wire, written from the packages' definitions.

Shares nothing with the Rust side: what both understand, they understand by the standard.
"""

from dataclasses import dataclass, field

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int8, int32, int64, sequence, uint8, uint16, uint32


def _name(package, kind, name):
    return f"{package}.{kind}.dds_.{name}_"


@dataclass
class Time(IdlStruct, typename=_name("builtin_interfaces", "msg", "Time")):
    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Duration(IdlStruct, typename=_name("builtin_interfaces", "msg", "Duration")):
    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Header(IdlStruct, typename=_name("std_msgs", "msg", "Header")):
    stamp: Time
    frame_id: str = ""


@dataclass
class Clock(IdlStruct, typename=_name("rosgraph_msgs", "msg", "Clock")):
    clock: Time


@dataclass
class Bool(IdlStruct, typename=_name("std_msgs", "msg", "Bool")):
    data: bool


@dataclass
class String(IdlStruct, typename=_name("std_msgs", "msg", "String")):
    data: str


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
class PoseStamped(IdlStruct, typename=_name("geometry_msgs", "msg", "PoseStamped")):
    header: Header
    pose: Pose


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
class JointTrajectoryControllerState(
    IdlStruct, typename=_name("control_msgs", "msg", "JointTrajectoryControllerState")
):
    header: Header
    joint_names: sequence[str]
    reference: JointTrajectoryPoint
    feedback: JointTrajectoryPoint
    error: JointTrajectoryPoint
    output: JointTrajectoryPoint
    multi_dof_joint_names: sequence[str]
    multi_dof_reference: MultiDOFJointTrajectoryPoint
    multi_dof_feedback: MultiDOFJointTrajectoryPoint
    multi_dof_error: MultiDOFJointTrajectoryPoint
    multi_dof_output: MultiDOFJointTrajectoryPoint
    speed_scaling_factor: float64


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


# What follows are actions, as rmw_cyclonedds_cpp puts them on the wire: requests and replies begin with the
# client's identity and a number, which a reply repeats.


@dataclass
class Request(IdlStruct, typename="bimanual.Request"):
    client: array[uint8, 8]
    number: int64


@dataclass
class GoalInfo(IdlStruct, typename=_name("action_msgs", "msg", "GoalInfo")):
    goal_id: array[uint8, 16]
    stamp: Time


@dataclass
class GoalStatus(IdlStruct, typename=_name("action_msgs", "msg", "GoalStatus")):
    goal_info: GoalInfo
    status: int8


@dataclass
class GoalStatusArray(IdlStruct, typename=_name("action_msgs", "msg", "GoalStatusArray")):
    status_list: sequence[GoalStatus]


@dataclass
class CancelRequest(IdlStruct, typename=_name("action_msgs", "srv", "CancelGoal_Request")):
    request: Request
    goal_info: GoalInfo


@dataclass
class CancelReply(IdlStruct, typename=_name("action_msgs", "srv", "CancelGoal_Response")):
    request: Request
    return_code: int8
    goals_canceling: sequence[GoalInfo]


class Action:
    """The messages of an action of control_msgs."""

    def __init__(self, kind, Goal, Result, Feedback):
        name = lambda part: _name("control_msgs", "action", f"{kind}_{part}")

        @dataclass
        class SendGoalRequest(IdlStruct, typename=name("SendGoal_Request")):
            request: Request
            goal_id: array[uint8, 16]
            goal: Goal

        @dataclass
        class SendGoalReply(IdlStruct, typename=name("SendGoal_Response")):
            request: Request
            accepted: bool
            stamp: Time

        @dataclass
        class ResultRequest(IdlStruct, typename=name("GetResult_Request")):
            request: Request
            goal_id: array[uint8, 16]

        @dataclass
        class ResultReply(IdlStruct, typename=name("GetResult_Response")):
            request: Request
            status: int8
            result: Result

        @dataclass
        class FeedbackMessage(IdlStruct, typename=name("FeedbackMessage")):
            goal_id: array[uint8, 16]
            feedback: Feedback

        self.SendGoalRequest, self.SendGoalReply = SendGoalRequest, SendGoalReply
        self.ResultRequest, self.ResultReply = ResultRequest, ResultReply
        self.FeedbackMessage = FeedbackMessage
        self.Result, self.Feedback = Result, Feedback


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
class FollowResult(IdlStruct, typename=_name("control_msgs", "action", "FollowJointTrajectory_Result")):
    error_code: int32 = 0
    error_string: str = ""


@dataclass
class FollowFeedback(IdlStruct, typename=_name("control_msgs", "action", "FollowJointTrajectory_Feedback")):
    header: Header
    joint_names: sequence[str]
    desired: JointTrajectoryPoint
    actual: JointTrajectoryPoint
    error: JointTrajectoryPoint
    multi_dof_joint_names: sequence[str] = field(default_factory=list)
    multi_dof_desired: MultiDOFJointTrajectoryPoint = field(default_factory=lambda: _no_dof())
    multi_dof_actual: MultiDOFJointTrajectoryPoint = field(default_factory=lambda: _no_dof())
    multi_dof_error: MultiDOFJointTrajectoryPoint = field(default_factory=lambda: _no_dof())


def _no_dof():
    return MultiDOFJointTrajectoryPoint([], [], [], Duration())


@dataclass
class GripperCommand(IdlStruct, typename=_name("control_msgs", "msg", "GripperCommand")):
    position: float64
    max_effort: float64


@dataclass
class GripperCommandGoal(IdlStruct, typename=_name("control_msgs", "action", "GripperCommand_Goal")):
    command: GripperCommand


@dataclass
class GripperCommandResult(IdlStruct, typename=_name("control_msgs", "action", "GripperCommand_Result")):
    position: float64
    effort: float64
    stalled: bool
    reached_goal: bool


@dataclass
class GripperCommandFeedback(IdlStruct, typename=_name("control_msgs", "action", "GripperCommand_Feedback")):
    position: float64
    effort: float64
    stalled: bool
    reached_goal: bool


@dataclass
class ParallelGoal(IdlStruct, typename=_name("control_msgs", "action", "ParallelGripperCommand_Goal")):
    command: JointState


@dataclass
class ParallelResult(IdlStruct, typename=_name("control_msgs", "action", "ParallelGripperCommand_Result")):
    state: JointState
    stalled: bool
    reached_goal: bool


@dataclass
class ParallelFeedback(IdlStruct, typename=_name("control_msgs", "action", "ParallelGripperCommand_Feedback")):
    state: JointState


ACTIONS = {
    "FollowJointTrajectory": Action("FollowJointTrajectory", FollowGoal, FollowResult, FollowFeedback),
    "GripperCommand": Action("GripperCommand", GripperCommandGoal, GripperCommandResult, GripperCommandFeedback),
    "ParallelGripperCommand": Action("ParallelGripperCommand", ParallelGoal, ParallelResult, ParallelFeedback),
}
