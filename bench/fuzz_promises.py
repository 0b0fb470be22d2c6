"""What the controller promises at every tick, judged by the world's own account of what happened.

On every command: as many finite numbers as joints, on the wire what was decided; velocity,
acceleration and braking limits; slower only, unless it servoes; zeros at once for what must stop at
once. On every motion: it was asked for, on fresh inputs, several good ones after a trouble; and it
ends when the error grows, does not fall or swings, when arm or image do not follow, when the
Jacobian is wrong or near singular. On every word: state, reason and sentence agree.
"""

from __future__ import annotations

import math

import numpy as np

from bench.fuzz_world import LONGEST_TICK_S, MAX_AGE, TICK_S, World, keep
from fvs_controller_node.config import SupervisorConfig
from fvs_controller_node.reasons import Reason, State, Stop

#: What a promise may be missed by: rounding, rad/s.
ROUNDING = 1e-9
#: What is sent stays below each limit by less than this share.
BELOW = 0.999
#: Full braking is reached within this time, s.
LONGEST_BUILD_UP_S = 0.1
#: The controller knows from late images what the world sees at once: it may notice this much later,
#: s, or at this much larger a value.
LATE_S, MARGIN = 1.0, 1.5


class JudgedWorld(World):
    """A world in which each command of the controller is judged."""

    def __init__(self, parameters=None, **world):
        super().__init__(parameters, **world)
        self._ticked_s = -math.inf
        self._held_s = self._stopping_s = 0.0
        self._ignored_rad = np.zeros(self.joints.size)
        self._dt_s = 0.0
        self._errand = None
        self._step = np.zeros(self.joints.size)  # to the last command
        self._unchanged_s = 0.0  # what the ticks since the last change of task or limit counted for

    def _begin_image(self):
        """Count anew what the arm does on a wrong image; an object was put elsewhere, maybe."""
        self._errand = None if self.on_arm else self._errand
        self._from_m, self._travel_m, self._fastest_m_s = self.arm_moved_m(), 0.0, 0.0

    def judge(self, command, now_s, dt_s):
        """Judge a tick: steady clock and time step, s."""
        v, reason = command.velocity_rad_s, command.reason
        if self.new_task:
            self._errand, self._unchanged_s = None, 0.0
        elif abs(dt_s - self._dt_s) > 0.1 * dt_s:  # a period that was learned anew
            self._unchanged_s = 0.0
        else:
            self._unchanged_s += dt_s
        if self.new_task or self.new_image:
            self._begin_image()
        self.new_task = self.new_image = False
        numbers = v.shape == self.joints.shape and v.dtype == float and np.isfinite(v).all()
        keep("one finite number a joint", numbers, v)
        keep("a tick counts for a period at most", dt_s <= TICK_S, dt_s)
        self._judge_sent(v, dt_s)
        passed_s = min(max(now_s - self._ticked_s, 0.0), LONGEST_TICK_S)
        self._ticked_s = now_s
        jerk = self.values["max_joint_jerk_rad_s3"]
        servoing = command.state is State.SERVOING
        brake_rad_s2, fast = (
            self.values[f"max_joint_{name}"] for name in ("acceleration_rad_s2", "velocity_rad_s")
        )
        if not servoing and not jerk:  # coming to rest takes half a second
            brake_rad_s2 = max(brake_rad_s2, fast / 0.5)
        stands = np.array_equal(v, self.before) or not v.any()
        keep("a tick that counts for nothing changes nothing", dt_s or stands, v)
        if dt_s:
            self._judge_limits(command, brake_rad_s2, brake_rad_s2 * dt_s, fast)
        trouble = not self.program_runs or self.scaling <= 0.0 or self.bad - self.idle
        at_once, moves = reason.stop is Stop.AT_ONCE, not jerk and v.any()
        keep("zeros at once", not (at_once and moves), v, reason.name)
        keep("zeros whatever came first", not (trouble and moves), v, reason.name, self.bad)
        self._judge_ramp(v, dt_s, trouble or at_once, brake_rad_s2, jerk)
        agree = reason.state is command.state
        agree |= command.state is State.WAITING and not self.session
        keep("state and reason agree", agree, command.state, reason.name)
        keep("the law is asked to servo only", (command.output is not None) == servoing)
        keep("says why", command.text.strip(), reason.name)
        if servoing:
            self._judge_session(now_s)
            self._judge_servoing(dt_s)
            self._judge_image(dt_s)
            self._held_s = 0.0
        else:
            self._held_s += passed_s
            self._ignored_rad = np.zeros_like(v)
            follows = not self.honest or reason is not Reason.NOT_FOLLOWING
            keep("an arm that follows is not held for it", follows, command.text)
            self._begin_image()
        long = self._held_s > self.values["resume_within_s"] + 2.0 * LONGEST_TICK_S
        if long or reason.needs_start:
            self.end_session()

    # ---- every command --------------------------------------------------------------------

    @property
    def _builds_up(self):
        """Whether, within a jerk limit, an acceleration may still go and braking build up."""
        jerk = self.values["max_joint_jerk_rad_s3"]
        return jerk > 0.0 and self._unchanged_s < TICK_S + 2.0 * LONGEST_BUILD_UP_S

    def _judge_sent(self, v, dt_s):
        """On the wire is what was decided, and of a position the step of one period."""
        same = not dt_s and np.array_equal(v, self.before)  # then it need not be repeated
        if not self.positions:
            decided = all(np.array_equal(sent.data, v) for sent in self.wire)
            keep("sends what it decided", decided and (same or self.wire), v, self.wire)
            return
        # Before the first motion of a session the joints may not be where they were measured.
        active = (self.node._loop.supervisor.started and self.goes_to is not None) or v.any()
        lock_step = self.node.simulated_time
        keep("positions in a session only", active or lock_step or not self.wire, self.wire)
        keep("positions all the time", self.wire or same or not active, v)
        for sent in self.wire:
            to = np.array(sent.data)
            start = self.joints if self.goes_to is None else self.goes_to
            most = TICK_S * self.values["max_joint_velocity_rad_s"] * self.limits.share
            near = np.all(np.abs(to - start) <= most + ROUNDING)
            keep("a position is a step away", near or not active, to, start)
            measured = self.node._loop.measured_rad
            known = start, start if measured is None else measured
            low = np.minimum(self.limits.lower_rad, np.min(known, axis=0)) - ROUNDING
            high = np.maximum(self.limits.upper_rad, np.max(known, axis=0)) + ROUNDING
            inside = np.all((low <= to) & (to <= high))
            keep("a position is in range", inside or not active, to, start)
            self.goes_to = to if active else None
        self.goes_to = self.goes_to if active else None

    def _judge_ramp(self, v, dt_s, stops, brake_rad_s2, jerk):
        """A stop within a jerk limit takes as long as the limits ask for."""
        if not stops or not self._unchanged_s:
            self._stopping_s = 0.0
            fastest = np.abs(v / self.limits.share).max()
            # An acceleration goes first, and makes it faster by half of what that takes.
            self._stops_in_s = fastest / brake_rad_s2 + 2.5 * brake_rad_s2 / max(jerk, 1.0)
            return
        self._stopping_s += dt_s
        ok = np.abs(v).max() < 1e-3 or self._stopping_s < self._stops_in_s + 5.0 * TICK_S
        keep("rests as soon as the limits allow", ok, v, self._stopping_s, self._stops_in_s)

    def _judge_limits(self, command, brake_rad_s2, step_rad_s, fast_rad_s):
        # In units of the joints' shares, in which all have the same limits.
        share, reason = self.limits.share, command.reason
        v, last = self.last / share, self.before / share
        fastest, before = np.abs(v).max(), np.abs(last).max()
        jerk = self.values["max_joint_jerk_rad_s3"]
        at_once = reason.stop is Stop.AT_ONCE and not jerk
        slower_rad_s = braked_rad_s = BELOW * step_rad_s
        before_step = self._step
        self._judge_jerk(v, last, step_rad_s / brake_rad_s2, jerk)
        if jerk > 0.0:
            dt_s = step_rad_s / brake_rad_s2
            built = np.abs(before_step) / dt_s + dt_s * jerk
            braked_rad_s = BELOW * dt_s * np.minimum(brake_rad_s2, built)
            if self._builds_up or not v.any():
                return
            # Deceleration falls to zero where the limit is reached.
            twice = 2.0 * jerk * max(0.0, before - fast_rad_s)
            ending = twice / (((jerk * dt_s) ** 2 + twice) ** 0.5 + jerk * dt_s + 1e-300)
            slower_rad_s = BELOW * dt_s * min(brake_rad_s2, ending)
        # A limit that is lowered in motion is reached by braking with all there is.
        ok = fastest <= fast_rad_s or fastest <= before - slower_rad_s + ROUNDING
        keep("velocity limit", ok, v, last, fast_rad_s)
        # From rest, zeros need no ramp.
        zeros = not v.any() and (at_once or before <= 1.5e-9)
        ok = zeros or np.abs(v - last).max() <= step_rad_s + ROUNDING
        keep("acceleration limit", ok, v, last, step_rad_s, reason.name)
        if command.state is not State.SERVOING and not jerk:
            slower = np.all((v * last >= 0.0) & (np.abs(v) <= np.abs(last)))
            keep("only slower", slower, v, last, reason.name)
        joints_rad = self.node._loop._joints  # as the controller knows them, noise averaged
        if joints_rad is None or not v.any():
            return
        # No joint goes outward faster than it can brake, unless it brakes already.
        ends = np.where(v > 0.0, self.limits.upper_rad, self.limits.lower_rad)
        room = np.maximum(0.0, np.sign(v) * (ends - joints_rad)) / share
        if jerk > 0.0:  # full braking builds up first
            room += np.abs(v) * 2.0 * brake_rad_s2 / jerk
        in_time = np.abs(v) <= np.sqrt(2.0 * brake_rad_s2 * room) + ROUNDING
        braking = (v * last > 0.0) & (np.abs(v) <= np.abs(last) - braked_rad_s + ROUNDING)
        keep("stops before its limit", np.all(in_time | braking), v, last, room, reason.name)

    def _judge_jerk(self, v, last, dt_s, jerk):
        """As a driver differentiates: the steps of two commands in a row."""
        before, same = self._step, self._unchanged_s > 1.5 * dt_s  # one step after a change
        self._step, self._dt_s = v - last, dt_s
        ok = not jerk or not same or np.abs(v - last - before).max() <= jerk * dt_s**2 + ROUNDING
        keep("jerk limit", ok, v, last, before, jerk)
        if not jerk and not v.any():  # at once
            self._step = np.zeros_like(v)

    # ---- every motion ---------------------------------------------------------------------

    def _judge_session(self, now_s):
        """It was asked for, on fresh inputs."""
        if self._autostart_left:  # it starts once by itself
            self.session, self._autostart_left = True, False
        keep("moves when asked only", self.session)
        for name in {*MAX_AGE} - self.idle:
            age_s = now_s - self.arrived_s[name]
            keep("fresh inputs", age_s <= self.max_age_s(name), name, age_s)
            trusted = self.good[name] == math.inf
            keep("several good messages end a trouble", trusted, name, self.good[name])

    def _judge_servoing(self, dt_s):
        """It ends when it leads nowhere."""
        values = self.values
        fastest, before = np.abs(self.last).max(), np.abs(self.before).max()
        # A start leaves a singular pose slowly, for ten seconds.
        leaves = self.now_s - self.asked_s < 10.0 + LATE_S and fastest <= 0.1 + ROUNDING
        low = self.singular_m_rad < values["singular_hold_m_rad"]
        ok = not low or leaves or fastest < before or self._builds_up
        keep("held near a singularity", ok, self.singular_m_rad, self.last)

        target_m, ball_m = self.target_m, self.ball()
        if self._errand is None or not self._errand.same(target_m, ball_m):
            self._errand = _Errand(target_m, ball_m)
            self._ignored_rad = np.zeros_like(self.last)
        wrong = self._errand.add(ball_m, dt_s, values)
        keep(wrong, not wrong, ball_m, target_m)

        # 30 mrad to 50 mrad, and once more as far as drives lag.
        stuck = self.plant == "ignores" and self.scaling >= 100.0
        self._ignored_rad += dt_s * self.last if stuck else -self._ignored_rad
        ok = np.all(np.abs(self._ignored_rad) < 0.055 + 0.21 * values["max_joint_velocity_rad_s"])
        keep("an arm that does not follow is held", ok, self._ignored_rad)

    def _judge_image(self, dt_s):
        """It ends when image and Jacobian do not agree, by what a good drive does."""
        moves = self.on_arm and self.values["object_moves"]
        if moves or self.estimate is not self.true or self.plant not in ("obeys", "lags"):
            return
        speed_m_s = np.linalg.norm(self.true @ self.drive)
        self._fastest_m_s = max(self._fastest_m_s, speed_m_s)
        self._travel_m += speed_m_s * dt_s
        # It is found after 3 cm of predicted motion; an arm that is fast needs half a second, too,
        # and a slow camera six images.
        least_m = 0.03 + max(0.5, 6.0 * self.image_period_s()) * self._fastest_m_s
        if self.seen_share == 0.0:
            astray_m = np.linalg.norm(self.arm_moved_m() - self._from_m)
            keep("a frozen image is held", astray_m < least_m, astray_m)
        elif self.seen_share == -1.0 and self.values["prediction_hold"] < 1.5:
            least_m += SupervisorConfig.prediction_hold_m
            keep("a wrong Jacobian is held", self._travel_m < least_m, self._travel_m)


class _Errand:
    """How the ball comes from where it is, m, to its target, m, by the world's own eyes."""

    def __init__(self, target_m, ball_m):
        self._target_m, self._ball_m = target_m, ball_m
        self._turned_m = ball_m - target_m  # the error when it last went on by a swing
        self._first_m = self._best_m = float(np.linalg.norm(self._turned_m))
        self._mark_m = math.inf
        self._up_s = self._since_s = self._still_s = self._swings_m = 0.0

    def same(self, target_m, ball_m):
        """Whether it is the same target, and the ball did not leap: some 2.5 m/s in a tick."""
        leap_m, self._ball_m = float(np.linalg.norm(ball_m - self._ball_m)), ball_m
        return leap_m <= 0.02 and np.array_equal(target_m, self._target_m)

    def add(self, ball_m, dt_s, values):
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
