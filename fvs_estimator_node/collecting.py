"""One collection run: when the arm may move, where it goes, and what is recorded. No ROS.

The collector commands the arm without the controller, so it has its own guard. Nothing moves before
joints and, from every camera, the ball have arrived. Late joint states stop the arm. A ball out of
all cameras' view sends it back to its start. A joint that leaves its box or its range, or moves
against its command, ends the run. Ticks that do not come, for up to half a second, move no joint
beyond its range.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from fvs_estimator_node.in_view import InView
from fvs_estimator_node.motion import MotionConfig, RandomMotion
from fvs_ros.following import Following
from fvs_ros.interface import CommandInterface
from fvs_ros.kinds import KindConfig
from fvs_ros.limiter import CommandLimiter
from fvs_ros.limits import limit_speed, tick_s
from fvs_ros.params import parameter
from fvs_ros.timeline import Sample, Timeline, repeats, too_slow

#: Largest age of joint states before the arm stops, and of the ball before it turns back, s.
_JOINTS_MAX_AGE_S, _BALL_MAX_AGE_S = 0.1, 0.5
#: A joint that moves by so much against its command has the wrong sign, rad.
_AGAINST_RAD = 0.01
#: A driver holds the last command while this computer stalls: within this time it takes no joint
#: beyond its range, s. A stall of 0.5 s, and a drive's lag of 0.1 s.
_HELD_S = 0.6
#: Speed of the path with the camera on the arm, over the limit: the rest is left for keeping the
#: object in view.
_IN_VIEW_SHARE = 0.4
#: Time from the first joint state on in which robot_description comes, if there is one, s.
_DESCRIPTION_S = 2.0
#: Time without joint states or ball after which the run ends with an error, s. Drivers and
#: detectors start sooner.
GIVE_UP_S = 10.0


@dataclass(frozen=True)
class CollectorConfig(MotionConfig, KindConfig, CommandInterface):
    """What is recorded, how the arm moves, and what ends it."""

    output_path: str = parameter("out/collect/dataset.npz", "data set file to write")
    seed: int = parameter(0, "seed of the motion", 0)

    @property
    def path_speed_rad_s(self) -> float:
        """Speed of the path, rad/s."""
        slow = _IN_VIEW_SHARE * self.max_joint_velocity_rad_s
        return slow if self.kind.on_arm else super().path_speed_rad_s

    def allowed_rad(self, box_rad: np.ndarray) -> np.ndarray:
        """Where joints may be, (2, n), rad: in their ranges, and within a stall of their box."""
        speed = self.max_joint_velocity_rad_s
        stall = _HELD_S * speed + 0.5 * speed**2 / self.max_joint_acceleration_rad_s2
        out = np.outer([-stall, stall], self.share)
        return np.clip(box_rad + out, self.lower_rad, self.upper_rad)


#: A run keeps the values that it began with.
PARAMETERS = tuple(replace(item, live=False) for item in CollectorConfig.declared())


class State(Enum):
    """What the run is doing."""

    WAITING = "WAITING"
    MOVING = "MOVING"
    RETURNING = "RETURNING"
    HOLDING = "HOLDING"
    DONE = "DONE"
    FAILED = "FAILED"


_OVER = (State.DONE, State.FAILED)


class CollectionRun:
    """Moves the joints and records what is seen.

    ``config`` holds the limits in force, ``reason`` explains the ``state`` in words, ``samples``
    are the recordings of each camera.
    """

    def __init__(self, config: CollectorConfig) -> None:
        self.config, self._names = config, config.joint_names
        self._motion: RandomMotion | None = None
        self._in_view: InView | None = None  # with the camera on the arm
        self._parts = config.kind.parts
        self._timelines = [Timeline() for _ in self._parts]
        self._joints: np.ndarray | None = None
        self._first_s = self._joints_s = -np.inf
        self._ball_s = [-np.inf for _ in self._parts]
        self._limiter = CommandLimiter(config, _HELD_S)
        self._following = Following()
        self._speed_scaling = 1.0
        self._moved_s = 0.0
        self._trouble_s: float | None = None
        self._others = ""
        self.state = State.WAITING
        self.reason = "waiting for joint_states"
        self.samples: list[list[Sample]] = [[] for _ in self._parts]

    @property
    def progress(self) -> float:
        """Share of the motion that is done."""
        return min(1.0, self._moved_s / self.config.duration_s)

    @property
    def moves(self) -> bool:
        """Whether the arm is under way."""
        return self._motion is not None and self.state not in _OVER

    @property
    def ended(self) -> bool:
        """Whether the run is over and the arm at rest."""
        return self.state in _OVER and not np.any(self._limiter.velocity_rad_s)

    @property
    def image_trouble(self) -> str:
        """Why a camera's images give no model: too slow, or none usable; empty if they do."""
        for samples, timeline in zip(self.samples, self._timelines, strict=True):
            newest = [each.stamp_s for each in samples[-9:]]
            if trouble := too_slow(newest) if newest else timeline.last_reason:
                return f"; {trouble}"
        return ""

    def joint_states(self, now_s: float, stamp_s: float, joints_rad: np.ndarray) -> None:
        """Take joint positions: arrival on the steady clock and stamp, s; (n,), rad."""
        if not repeats(stamp_s, self._timelines[0].joints.newest_stamp_s):
            self._first_s = now_s if self._joints is None else self._first_s
            self._joints, self._joints_s = joints_rad, now_s
            if self.moves:
                unit = self.config.unit
                command = self._speed_scaling * self._limiter.velocity_rad_s / unit
                self._following.add(now_s, stamp_s, command, joints_rad / unit)
            else:
                self._following.restart()
        for camera, timeline in enumerate(self._timelines):
            self._record(camera, timeline.add_joints(stamp_s, joints_rad))

    def image(self, now_s: float, stamp_s: float, z: np.ndarray, camera: int = 0) -> None:
        """Take a camera's measurement, (m,): arrival on the steady clock and exposure stamp, s."""
        timeline = self._timelines[camera]
        if not repeats(stamp_s, timeline.seen_stamp_s):
            self._ball_s[camera] = now_s
            self._record(camera, timeline.add_image(stamp_s, z))

    def configure(self, config: CollectorConfig) -> None:
        """Take limits that are known only now; a motion begins anew within them."""
        if config != self.config:
            self.config, self._motion, self._moved_s = config, None, 0.0
            self._limiter.limits = config
            self._following.restart()

    def speed_scaling(self, share: float) -> None:
        """Take the robot's speed scaling, 0 to 1."""
        self._speed_scaling = share

    def other_publishers(self, names: Sequence[str]) -> None:
        """Take the names of the other nodes that publish joint commands.

        Nothing starts while there is one, and a moving arm is stopped.
        """
        self._others = ", ".join(names)
        if names and self._motion is not None:
            self.fail(f"{self._others} commands the arm as well; stop it, then collect again")

    def fail(self, reason: str) -> None:
        """End the run: the arm ramps to rest, what was recorded stays."""
        if self.state not in _OVER:
            self.state, self.reason = State.FAILED, reason

    def interrupt(self) -> np.ndarray:
        """End the run: the velocity, rad/s, (n,), from which the arm has to come to rest."""
        self.fail("interrupted")
        if not self.config.max_joint_jerk_rad_s3:
            self._limiter.stop()
        return self._limiter.velocity_rad_s

    def _record(self, camera: int, samples: list[Sample]) -> None:
        if self.state in (State.MOVING, State.RETURNING):
            self.samples[camera].extend(samples)
            if self._in_view is not None:
                for sample in samples:
                    self._in_view.learn(sample.joints_rad, sample.z)

    def tick(self, now_s: float, dt_s: float) -> np.ndarray:
        """Joint velocities for this tick, rad/s, shape (n,); always finite and within limits.

        ``dt_s`` is what the tick counts for, s.
        """
        dt_s = tick_s(dt_s)
        wanted = None if self.state in _OVER else self._decide(now_s, dt_s)
        joints, limiter = self._joints, self._limiter
        # The driver has held the last command since the joint state came.
        held_s = 0.0 if joints is None else now_s - self._joints_s
        pending_rad = held_s * limiter.velocity_rad_s
        if wanted is None or joints is None or not np.all(np.isfinite(wanted)):
            limiter.rest(joints, dt_s, pending_rad)
        else:
            limiter.move(wanted, joints, dt_s, pending_rad)
        return limiter.velocity_rad_s.copy()

    def _decide(self, now_s: float, dt_s: float) -> np.ndarray | None:
        """Advance the state machine; returns wanted velocities, rad/s, or None to come to rest."""
        late = _late("no joint_states", now_s - self._joints_s, _JOINTS_MAX_AGE_S)
        unseen = [
            _late(f"no {part.feature.name}", now_s - ball_s, _BALL_MAX_AGE_S)
            for part, ball_s in zip(self._parts, self._ball_s, strict=True)
        ]
        missing = ", ".join(filter(None, unseen))
        # It begins with every camera, and goes on with any.
        lost = missing if self._motion is None or all(unseen) else ""
        joints = self._joints
        others = f"{self._others} commands the arm as well; stop it first" if self._others else ""
        unknown = ""
        if not self.config.ranges_known and now_s - self._first_s < _DESCRIPTION_S:
            unknown = "no robot_description yet, which may have the joints' ranges"
        before = (lost or others or unknown) if self._motion is None else ""
        if late or before or joints is None:
            self._wait(now_s, State.HOLDING, late or before)
            return None
        if self._motion is None:
            self._begin(joints)
        if self._motion is None:
            return None
        motion = self._motion
        self._watch_box(joints, motion.box_rad)
        self._watch_following()
        if self.state is State.FAILED:
            return None
        self._moved_s += dt_s
        over_s = self._moved_s - self.config.duration_s
        if over_s >= 0.0:
            self._trouble_s = None
            if motion.done(self._moved_s, joints) or over_s > GIVE_UP_S:
                self.state, self.reason = State.DONE, "finished"
                return None
            self.state, self.reason = State.RETURNING, "back to where it began"
        elif lost:
            if self._in_view is not None and self.state is State.MOVING:
                self._in_view.lost()
            motion.return_home()
            self._wait(now_s, State.RETURNING, lost + self.image_trouble)
        else:
            self._trouble_s = None
            motion.resume(self._moved_s, joints)
            self.state = State.MOVING
            self.reason = "moving and recording" + (missing and f"; {missing}") + self.image_trouble
        moves = self.state in (State.MOVING, State.RETURNING)
        return self._command(motion, joints) if moves else None

    def _begin(self, joints: np.ndarray) -> None:
        config = self.config
        try:
            self._motion = RandomMotion(joints, config, np.random.default_rng(config.seed))
        except ValueError as error:
            self.fail(str(error))
            return
        if config.kind.on_arm:
            self._in_view = InView(config.kind, self._motion.box_rad, config.share)

    def _command(self, motion: RandomMotion, joints: np.ndarray) -> np.ndarray:
        velocity = motion.command(self._moved_s, joints)
        if self._in_view is None or self.state is State.RETURNING:
            return velocity
        velocity = limit_speed(velocity, self.config.path_speed_rad_s, self.config.share)
        return self._in_view.limited(velocity, joints)

    def _watch_box(self, joints: np.ndarray, box_rad: np.ndarray) -> None:
        low, high = self.config.allowed_rad(box_rad)
        joint = int(np.maximum(low - joints, joints - high).argmax())
        if not low[joint] <= joints[joint] <= high[joint]:
            self.fail(
                f"{self._names[joint]} left its box or its range: it is at {joints[joint]:.3g} "
                f"rad (m), expected {low[joint]:.3g} to {high[joint]:.3g}; check that no "
                "other node moves the arm and that this computer is not too busy"
            )

    def _watch_following(self) -> None:
        fault = self._following.fault
        if fault is None:
            return
        name = self._names[fault.joint]
        if fault.moved_rad * np.sign(fault.commanded_rad) < -_AGAINST_RAD:
            self.fail(f"{name} moves against its command; check joint_names and the joint's sign")
        else:
            made = self.config.unit[fault.joint] * np.array(fault[1:])
            self.fail(
                f"the arm does not follow: {name} was commanded {made[0]:.2g} "
                f"rad (m) and moved {made[1]:.2g}; check that its "
                "controller is active, the robot program runs and no protective stop is on"
            )

    def _wait(self, now_s: float, state: State, reason: str) -> None:
        self.state, self.reason = (State.WAITING if self._motion is None else state), reason
        if self._trouble_s is None:
            self._trouble_s = now_s
        elif now_s - self._trouble_s > GIVE_UP_S:
            self.fail(f"gave up after {GIVE_UP_S:g} s: {reason}")


def _late(what: str, age_s: float, most_s: float) -> str:
    """Text about an input of an age, s, if it is late; empty if not."""
    when = "none so far" if np.isinf(age_s) else f"last {age_s:.1f} s ago"
    return f"{what} ({when})" if age_s > most_s else ""
