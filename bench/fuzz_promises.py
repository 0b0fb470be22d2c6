"""What the controller promises at every tick, judged by the world's own account of what happened.

On every command: as many finite numbers as joints, on the wire what was decided; velocity,
acceleration and braking limits; slower only, unless it servoes; zeros at once for what must stop at
once. On every motion: it was asked for, on fresh inputs, several good ones after a trouble; and it
ends when the error grows, does not fall or swings, when arm or image do not follow, when the
Jacobian is wrong or near singular. On every word: state, reason and sentence agree.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from fvs_controller_node.config import SupervisorConfig
from fvs_controller_node.reasons import State, Stop

if TYPE_CHECKING:
    from bench.fuzz_world import World
    from fvs_controller_node.supervisor import Command

#: A tick counts for at most this, s; a stop from full speed takes no longer than the other, s.
LONGEST_TICK_S, STOP_S = 0.05, 0.5
#: What a promise may be missed by: rounding, rad/s.
ROUNDING = 1e-9
#: Below this speed the arm is at rest and zeros need no ramp, rad/s.
AT_REST = 1.5e-9
#: The controller knows from late images what the world sees at once: it may notice this much later,
#: s, or at this much larger a value.
LATE_S, MARGIN = 1.0, 1.5
#: Leaving a singular pose on request: speed, rad/s, and time, s.
LEAVE_RAD_S, LEAVE_S = 0.1, 10.0
#: Predicted motion of the ball after which a frozen image or a wrong Jacobian is found, m.
FOUND_M = 0.03


class BrokenPromiseError(AssertionError):
    """The controller did what it must never do.

    Parameters
    ----------
    promise : str
        Which promise it broke.
    how : tuple
        The values that show it.
    """

    def __init__(self, promise: str, *how: Any) -> None:
        super().__init__(f"{promise}: {', '.join(map(str, how))}")
        self.promise = promise


class Promises:
    """Judges each command of a world's controller.

    Parameters
    ----------
    world : World
        The account of what the controller was told.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self.last = self._before = np.zeros(world.joints.size)  # the last two commands, rad/s
        self._ticked_s = -math.inf
        self._held_s = 0.0
        self.begin()

    def begin(self) -> None:
        """Count anew what only shows in time: a start, a change, a new target."""
        self._errand: Errand | None = None
        self._ignored_s = 0.0
        self.begin_lie()

    def begin_lie(self) -> None:
        """Count anew what the arm does on a wrong image."""
        self._lie_from_m, self._lie_way_m, self._lie_speed_m_s = self._world.arm_moved_m(), 0.0, 0.0

    def keep(self, promise: str, kept: bool, *how: Any) -> None:
        """Raise unless a promise was kept; ``how`` are the values that show it."""
        if not kept:
            raise BrokenPromiseError(promise, *how)

    def judge(self, command: Command, now_s: float, dt_s: float) -> None:
        """Judge a tick: steady clock and time step, s."""
        world, v, last, reason = self._world, command.velocity_rad_s, self.last, command.reason
        self.keep("six numbers", v.shape == last.shape and v.dtype == last.dtype, v)
        self.keep("finite", bool(np.isfinite(v).all()), v)
        self._before, self.last = last, v
        sent = len(world.wire) > 0 and all(np.array_equal(data, v) for data in world.wire)
        self.keep("sends what it decided", sent, v, world.wire)
        passed_s = min(max(now_s - self._ticked_s, 0.0), LONGEST_TICK_S)
        self._ticked_s = now_s
        dt_s = min(dt_s, LONGEST_TICK_S) if math.isfinite(dt_s) and dt_s > 0.0 else 0.0
        servoing = command.state is State.SERVOING
        brake_rad_s2, fast = (
            world.values[f"max_joint_{name}"] for name in ("acceleration_rad_s2", "velocity_rad_s")
        )
        if not servoing:  # simulated time may stand still; coming to rest must not
            brake_rad_s2, dt_s = max(brake_rad_s2, fast / STOP_S), dt_s or passed_s
        self._judge_limits(command, brake_rad_s2, brake_rad_s2 * dt_s, fast)
        if reason.stop is Stop.AT_ONCE:
            self.keep("zeros at once", not v.any(), v, reason.name)
        paused = not world.program_runs or world.scaling <= 0.0
        if paused or world.bad:
            self.keep("zeros whatever came first", not v.any(), v, reason.name, world.bad)
        agree = reason.state is command.state
        agree |= command.state is State.WAITING and not world.session
        self.keep("state and reason agree", agree, command.state, reason.name)
        asked = command.output is not None
        self.keep("the law is asked to servo only", asked == servoing, command.state)
        self.keep("says why", bool(command.text.strip()), reason.name)
        if servoing:
            self._judge_session(now_s)
            self._judge_servoing(dt_s)
            self._judge_image(dt_s)
            self._held_s = 0.0
        else:
            self._held_s += passed_s
            self._ignored_s = 0.0
            self.begin_lie()
        long = self._held_s > world.values["resume_within_s"] + 2.0 * LONGEST_TICK_S
        if long or reason.needs_start:
            world.end_session()

    # ---- every command --------------------------------------------------------------------

    def _judge_limits(
        self, command: Command, brake_rad_s2: float, step_rad_s: float, fast_rad_s: float
    ) -> None:
        world, v, last, reason = self._world, self.last, self._before, command.reason
        servoing = command.state is State.SERVOING
        fastest, before = np.abs(v).max(), np.abs(last).max()
        # A limit that is lowered in motion is reached by braking with all there is.
        ok = fastest <= fast_rad_s or fastest <= before - step_rad_s + ROUNDING
        self.keep("velocity limit", ok, v, last, fast_rad_s)
        change = np.abs(v - last).max()
        zeros = not v.any() and (reason.stop is Stop.AT_ONCE or before <= AT_REST)
        ok = zeros or change <= step_rad_s + ROUNDING
        self.keep("acceleration limit", ok, v, last, step_rad_s, reason.name)
        if not servoing:
            slower = np.all((v * last >= 0.0) & (np.abs(v) <= np.abs(last)))
            self.keep("only slower", bool(slower), v, last, reason.name)
        joints_rad = world.known_joints
        if joints_rad is None or not v.any():
            return
        # No joint goes outward faster than it can brake, unless it brakes already.
        ends = np.where(v > 0.0, world.values["joint_max_rad"], world.values["joint_min_rad"])
        room = np.maximum(0.0, np.sign(v) * (ends - joints_rad))
        in_time = np.abs(v) <= np.sqrt(2.0 * brake_rad_s2 * room) + ROUNDING
        braking = (v * last > 0.0) & (np.abs(v) <= np.abs(last) - step_rad_s + ROUNDING)
        ok = bool(np.all(in_time | braking))
        self.keep("stops before its limit", ok, v, last, room, reason.name)

    # ---- every motion ---------------------------------------------------------------------

    def _judge_session(self, now_s: float) -> None:
        """It was asked for, on fresh inputs."""
        world = self._world
        self.keep("moves when asked only", world.take_session())
        for name, limit_s in world.age_limits_s().items():
            age_s = now_s - world.arrived_s[name]
            self.keep("fresh inputs", age_s <= limit_s, name, age_s)
            trusted = world.good[name] == math.inf
            self.keep("several good messages end a trouble", trusted, name, world.good[name])

    def _judge_servoing(self, dt_s: float) -> None:
        """It ends when it leads nowhere."""
        world, values = self._world, self._world.values
        fastest, before = np.abs(self.last).max(), np.abs(self._before).max()
        leaves = world.now_s - world.asked_s < LEAVE_S + LATE_S
        leaves = leaves and fastest <= LEAVE_RAD_S + ROUNDING
        low = world.singular_m_rad < values["singular_hold_m_rad"]
        ok = not low or leaves or fastest < before
        self.keep("held near a singularity", bool(ok), world.singular_m_rad, self.last)

        target_m, ball_m = world.target_m, world.ball()
        assert target_m is not None
        errand = self._errand
        if errand is None or not errand.same(target_m, ball_m):
            errand = self._errand = Errand(target_m, ball_m)
            self._ignored_s = 0.0
        wrong = errand.add(ball_m, dt_s, values)
        self.keep(wrong, not wrong, ball_m, target_m)

        ignored = world.plant == "ignores" and fastest >= 0.05
        self._ignored_s += dt_s if ignored else 0.0
        ok = self._ignored_s < values["stall_time_s"] / 2.0 + LATE_S
        self.keep("an arm that does not follow is held", ok, self._ignored_s)

    def _judge_image(self, dt_s: float) -> None:
        """It ends when image and Jacobian do not agree, by what a good drive does."""
        world = self._world
        if world.estimate_is_wrong or world.plant not in ("obeys", "lags"):
            return
        speed_m_s = world.arm_speed_m_s()
        self._lie_speed_m_s = max(self._lie_speed_m_s, speed_m_s)
        self._lie_way_m += speed_m_s * dt_s
        # Half a second passes until enough was seen of an arm that is fast.
        least_m = FOUND_M + 0.5 * self._lie_speed_m_s
        if world.seen_share == 0.0:
            astray_m = float(np.linalg.norm(world.arm_moved_m() - self._lie_from_m))
            self.keep("a frozen image is held", astray_m < least_m, astray_m)
        elif world.seen_share == -1.0 and world.values["prediction_hold"] < 1.5:
            least_m += SupervisorConfig.prediction_hold_m
            self.keep("a wrong Jacobian is held", self._lie_way_m < least_m, self._lie_way_m)


class Errand:
    """How the ball comes to its target, by the world's own eyes.

    Parameters
    ----------
    target_m, ball_m : ndarray, shape (3,)
        The target, and the ball at the beginning, m.
    """

    def __init__(self, target_m: np.ndarray, ball_m: np.ndarray) -> None:
        self._target_m, self._ball_m = target_m, ball_m
        self._turned_m = ball_m - target_m  # the error when it last went on by a swing
        self._first_m = self._best_m = float(np.linalg.norm(self._turned_m))
        self._mark_m = math.inf
        self._up_s = self._since_s = self._still_s = self._swings_m = 0.0

    def same(self, target_m: np.ndarray, ball_m: np.ndarray) -> bool:
        """Whether it is the same target, and the ball did not leap."""
        leap_m, self._ball_m = float(np.linalg.norm(ball_m - self._ball_m)), ball_m
        return leap_m <= 0.1 and np.array_equal(target_m, self._target_m)

    def add(self, ball_m: np.ndarray, dt_s: float, values: dict[str, Any]) -> str:
        """Take a tick of servoing; the promise that is broken by it, mostly none."""
        error = ball_m - self._target_m
        error_m = float(np.linalg.norm(error))
        self._best_m = min(self._best_m, error_m)
        up_m = max(
            SupervisorConfig.growth_factor * self._best_m, self._best_m + SupervisorConfig.growth_m
        )
        self._up_s = self._up_s + dt_s if error_m > MARGIN * up_m else 0.0
        self._since_s += dt_s
        near = error_m < MARGIN * SupervisorConfig.stall_error_m
        if near or self._best_m < 0.98 * self._mark_m:
            self._mark_m, self._since_s = self._best_m, 0.0
        self._still_s += dt_s
        went_m = float(np.linalg.norm(error - self._turned_m))
        if went_m > 0.02:
            nearer_m = float(np.linalg.norm(self._turned_m)) - error_m
            self._swings_m += went_m - max(0.0, nearer_m)
            self._turned_m, self._still_s = error, 0.0
        elif self._still_s > 0.5:
            self._swings_m = 0.0
        broken = {
            "an error that grows is held": self._up_s > values["stall_time_s"] / 6.0 + LATE_S,
            "an error that does not fall is held": self._since_s > values["stall_time_s"] + LATE_S,
            "a swing is held": self._swings_m > MARGIN * (0.5 + 2.0 * self._first_m),
        }
        return next((promise for promise, is_broken in broken.items() if is_broken), "")
