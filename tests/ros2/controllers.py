"""What Jazzy's controllers do with what they are told, without any middleware.

Written after reading ros2_controllers, branch jazzy (ed360c9):

* diff_drive_controller/src/diff_drive_controller.cpp: a stamp of zero becomes the time of arrival; a command whose
  age is not below `cmd_vel_timeout` (0.5 s) is ignored; in each update the age of the *stored stamp* decides, and only
  an age above the timeout brakes. A stamp from the future is therefore obeyed until its time has come and 0.5 s more.
* joint_trajectory_controller: `validate_trajectory_msg`; `Trajectory::sample` (cubic between points with velocities,
  quintic with accelerations, linear without; a stamp of zero starts at the first sample; before the first point it
  blends from the measured state); the last point is held; a new goal aborts the active one; a message on the topic
  replaces the trajectory and leaves the active goal; cancelling holds the measured position at once.
* parallel_gripper_action_controller and gripper_action_controller: one position, success within the tolerance, stalled
  after `stall_timeout` without movement.

All angles in rad, times in s of the robot's own clock.
"""

import math

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
COMMAND_TIMEOUT_S = 0.5
# float32's epsilon, as the controller has it.
AT_REST = 1.1920929e-07


class Base:
    """A base behind diff_drive_controller; unstamped messages count from their arrival."""

    def __init__(self, timeout_s=COMMAND_TIMEOUT_S):
        self.timeout_s = timeout_s
        self.speed = (0.0, 0.0)
        self.pose = (0.0, 0.0, 0.0)
        self.command = None
        self.newest = 0.0
        self.received = self.dropped = self.stops = 0
        self.oldest_s = 0.0

    def take(self, now, stamp, linear, angular):
        """What becomes of a command: `acted`, `acted on an older one`, or `dropped` for its age."""
        self.received += 1
        age = now - stamp if stamp else 0.0
        if age >= self.timeout_s:
            self.dropped += 1
            return "dropped"
        self.oldest_s = max(self.oldest_s, age)
        older = bool(stamp) and stamp < self.newest
        self.newest = stamp or self.newest
        self.command = (stamp or now, linear, angular)
        return "acted on an older one" if older else "acted"

    def update(self, now, period):
        """Drives on; true when it has just stopped by itself."""
        x, y, heading = self.pose
        self.pose = (x + self.speed[0] * math.cos(heading) * period, y + self.speed[0] * math.sin(heading) * period,
                     heading + self.speed[1] * period)
        if self.command is None:
            return False
        stamp, linear, angular = self.command
        if now - stamp > self.timeout_s:
            stopped = self.speed != (0.0, 0.0)
            self.speed = (0.0, 0.0)
            self.stops += stopped
            return stopped
        if math.isfinite(linear) and math.isfinite(angular):
            self.speed = (linear, angular)
        return False


class Point:
    """A point of a trajectory: seconds from its start, and a value per joint."""

    def __init__(self, at_s, positions, velocities=(), accelerations=(), effort=()):
        self.at_s = at_s
        self.positions, self.velocities = list(positions), list(velocities)
        self.accelerations, self.effort = list(accelerations), list(effort)


class Trajectory:
    """A trajectory as it came: a stamp (0 = now), the joints' names, and points."""

    def __init__(self, stamp, names, points):
        self.stamp, self.names, self.points = stamp, list(names), points


def between(start_s, start, end_s, end, at_s):
    """Position and speed of each joint between two points, as `interpolate_between_points` has them."""
    whole = end_s - start_s
    t = min(max(at_s - start_s, 0.0), whole)
    has_velocity = bool(start.velocities) and bool(end.velocities)
    has_acceleration = bool(start.accelerations) and bool(end.accelerations)
    positions, velocities = [], []
    for joint, (p0, p1) in enumerate(zip(start.positions, end.positions)):
        if not has_velocity:
            slope = (p1 - p0) / whole if whole else 0.0
            positions.append(p0 + slope * t)
            velocities.append(slope)
            continue
        v0, v1 = start.velocities[joint], end.velocities[joint]
        c = [p0, v0, 0.0, 0.0, 0.0, 0.0]
        if whole and not has_acceleration:
            c[2] = (-3 * p0 + 3 * p1 - 2 * v0 * whole - v1 * whole) / whole**2
            c[3] = (2 * p0 - 2 * p1 + (v0 + v1) * whole) / whole**3
        elif whole:
            a0, a1 = start.accelerations[joint], end.accelerations[joint]
            c[2] = 0.5 * a0
            c[3] = (-20 * p0 + 20 * p1 - (12 * v0 + 8 * v1) * whole - (3 * a0 - a1) * whole**2) / (2 * whole**3)
            c[4] = (30 * p0 - 30 * p1 + (16 * v0 + 14 * v1) * whole + (3 * a0 - 2 * a1) * whole**2) / (2 * whole**4)
            c[5] = (-12 * p0 + 12 * p1 - 6 * (v0 + v1) * whole - (a0 - a1) * whole**2) / (2 * whole**5)
        positions.append(sum(factor * t**power for power, factor in enumerate(c)))
        velocities.append(sum(power * factor * t ** (power - 1) for power, factor in enumerate(c) if power))
    return positions, velocities


def wrapped(angle):
    """The same direction within (-pi, pi]."""
    return math.pi - (math.pi - angle) % (2 * math.pi)


class Arm:
    """An arm behind joint_trajectory_controller with its default parameters.

    `pace` scales time as speed scaling does; `lag_s` and `error_rad` are how the joints follow what they are told:
    late as a first-order filter, and short by a constant while they move. `wraps` are joints without end: their
    angles are reported within one turn and `angle_wraparound` is on.
    """

    def __init__(self, names, start, pace=1.0, lag_s=0.0, error_rad=0.0, wraps=()):
        self.names, self.pace, self.lag_s, self.error_rad = list(names), pace, lag_s, error_rad
        self.wraps = [name in wraps for name in names]
        self.command = list(start)
        self.position = list(start)
        self.velocity = [0.0] * len(start)
        self.desired = Point(0.0, start, [0.0] * len(start))
        self.goal = None
        self.finished = []
        self.hold()

    def reported(self):
        """The angles as a driver reports them."""
        return [wrapped(p) if turns else p for p, turns in zip(self.position, self.wraps)]

    def refusal(self, trajectory, now):
        """Why `validate_trajectory_msg` would not have this one; None = it is taken."""
        if len(trajectory.names) != len(self.names):
            return "joints on incoming trajectory don't match the controller joints"
        if not trajectory.points:
            return "empty trajectory received"
        for name in trajectory.names:
            if name not in self.names:
                return f"incoming joint {name} doesn't match the controller's joints"
        for name, velocity in zip(trajectory.names, trajectory.points[-1].velocities):
            if abs(velocity) > AT_REST:
                return f"velocity of last trajectory point of joint {name} is not zero: {velocity}"
        if trajectory.stamp and trajectory.stamp + trajectory.points[-1].at_s < now:
            return "trajectory with non-zero start time that ends in the past"
        before = 0.0
        for place, point in enumerate(trajectory.points):
            if place and point.at_s <= before:
                return f"time between points {place - 1} and {place} is not strictly increasing"
            before = point.at_s
            if len(point.positions) != len(trajectory.names):
                return f"mismatch between joint_names size and positions at point #{place}"
            for what in (point.velocities, point.accelerations):
                if what and len(what) != len(trajectory.names):
                    return f"mismatch between joint_names size and a field at point #{place}"
            if point.effort:
                return "effort fields are only for controllers with the effort command interface"
        return None

    def follow(self, trajectory):
        """Takes a trajectory that was found sound."""
        order = [trajectory.names.index(name) for name in self.names]
        sort = lambda values: [values[place] for place in order] if values else []
        self.points = [
            Point(p.at_s, sort(p.positions), sort(p.velocities), sort(p.accelerations)) for p in trajectory.points
        ]
        self.stamp, self.start, self.holding = trajectory.stamp, None, False

    def hold(self):
        """Stays where it is measured to be."""
        self.points = [Point(0.0, self.position, [])]
        self.stamp, self.start, self.holding = 0.0, None, True

    def accept(self, goal_id, trajectory):
        """A goal that was found sound and accepted."""
        if self.goal is not None:
            self.end(ABORTED, -1, "Current goal preempted by new incoming action.")
        self.goal = goal_id
        self.follow(trajectory)

    def end(self, status, code=0, text=""):
        """The active goal ends; `finished` tells it."""
        self.finished.append((self.goal, status, code, text))
        self.goal = None

    def cancel(self, goal_id):
        """Whether this goal was running; it is not any more."""
        if self.goal is None or self.goal != goal_id:
            return False
        self.end(CANCELED)
        self.hold()
        return True

    def sample(self, at):
        """Positions, velocities and whether the last point was passed, at this time of the trajectory."""
        first = self.start + self.points[0].at_s
        if at < first:
            return *between(self.before_at, self.before, first, self.points[0], at), False
        for point, after in zip(self.points, self.points[1:]):
            if self.start + point.at_s <= at < self.start + after.at_s:
                return *between(self.start + point.at_s, point, self.start + after.at_s, after, at), False
        last = self.points[-1]
        return list(last.positions), last.velocities or [0.0] * len(self.names), True

    def update(self, now, period):
        """Moves for one period of the controller."""
        if self.start is None:
            self.start = self.stamp or now
            self.at = now
            self.before_at = now
            still = [0.0] * len(self.names)
            self.before = Point(0.0, self.position, self.velocity if self.points[0].velocities else [],
                                still if self.points[0].accelerations else [])
            for joint, turns in enumerate(self.wraps):
                if turns:
                    wanted = self.points[0].positions[joint]
                    self.before.positions[joint] = wanted - wrapped(wanted - self.before.positions[joint])
            self.position = list(self.before.positions)
        else:
            self.at += period * self.pace
        positions, velocities, _ = self.sample(self.at)
        self.desired = Point(self.at - self.start, positions, velocities)
        _, _, over = self.sample(self.at)
        self.command, speeds, _ = self.sample(self.at + period * self.pace)
        share = 1.0 if self.lag_s <= 0.0 else 1.0 - math.exp(-period / self.lag_s)
        for joint, (wanted, speed) in enumerate(zip(self.command, speeds)):
            short = math.copysign(self.error_rad, speed) if abs(speed) > 1e-6 else 0.0
            moved = (wanted - short - self.position[joint]) * share
            self.position[joint] += moved
            self.velocity[joint] = moved / period
        if over and self.goal is not None:
            self.end(SUCCEEDED, 0, "Goal successfully reached!")


class Gripper:
    """A gripper behind one of the two gripper controllers: one position in m, moved at a fixed speed.

    `blocked_m` is where an object between the fingers stops them; they close towards larger positions.
    """

    def __init__(self, position_m=0.0, speed_m_s=0.1, blocked_m=None, tolerance_m=0.01, stall_s=1.0):
        self.position, self.wanted, self.speed = position_m, position_m, speed_m_s
        self.blocked, self.tolerance, self.stall_s = blocked_m, tolerance_m, stall_s
        self.goal = None
        self.moved_at = 0.0
        self.finished = []

    def accept(self, goal_id, wanted_m, now):
        """A goal; the one before it is aborted."""
        if self.goal is not None:
            self.finished.append((self.goal, ABORTED, False, False))
        self.goal, self.wanted, self.moved_at = goal_id, wanted_m, now

    def cancel(self, goal_id):
        """Whether this goal was running; the gripper stays where it is."""
        if self.goal is None or self.goal != goal_id:
            return False
        self.finished.append((self.goal, CANCELED, False, False))
        self.goal, self.wanted = None, self.position
        return True

    def update(self, now, period):
        """Moves for one period."""
        step = min(max(self.wanted - self.position, -self.speed * period), self.speed * period)
        after = self.position + step
        # The object is in the way of closing fingers, not of those that open.
        if self.blocked is not None and self.position <= self.blocked < after:
            after = self.blocked
        if abs(after - self.position) > 1e-9:
            self.moved_at = now
        self.position = after
        if self.goal is None:
            return
        if abs(self.wanted - self.position) < self.tolerance:
            self.finished.append((self.goal, SUCCEEDED, False, True))
            self.goal = None
        elif now - self.moved_at > self.stall_s:
            self.finished.append((self.goal, ABORTED, True, False))
            self.goal = None
