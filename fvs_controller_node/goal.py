"""The target in force, where the feature is, and the progress of the error between them."""

from __future__ import annotations

from math import inf
from typing import NamedTuple

import numpy as np

from fvs_controller_node.config import SupervisorConfig
from fvs_controller_node.reasons import Finding, Reason
from fvs_controller_node.target_motion import TargetMotions, Update
from fvs_ros.filter import GATE_M, OUTLIER
from fvs_ros.vectors import length

#: A swing is a change of the error by this, m, above noise. Without one for this time, s, the error
#: has come to rest. An oscillation is sustained when its swings sum to this path, m, plus twice the
#: initial distance to the target.
_SWING_M, _REST_S, _SWINGS_M = 0.01, 1.0, 0.5

#: Averaging time of the error, s; progress is a best error below this share of the last mark. The
#: error has come down, more than by noise, below this share of its highest.
_SMOOTH_S, _PROGRESS, _DOWN = 0.1, 0.97, 0.9


class _Mark(NamedTuple):
    """An error with the target at that time; later target motion is not blamed on the arm."""

    error: float | np.ndarray
    target_m: np.ndarray | None

    def gone_m(self, target_m: np.ndarray | None) -> float:
        if target_m is self.target_m or target_m is None or self.target_m is None:
            return 0.0
        return length(target_m - self.target_m)


class Progress:
    """Monitors whether the error, since the start or a new target, settles, grows or swings."""

    def __init__(self) -> None:
        self._task: np.ndarray | None = None  # the target of the last restart, m
        self.settled = False
        self.restart()

    def take_target(
        self, target_m: np.ndarray, config: SupervisorConfig, moving: bool = False
    ) -> None:
        """Restart if the target moved more than ``growth_m`` on its path, m, (d,), since then.

        A moving one is no new task, but the next one counts from there.
        """
        if moving:
            self._task = target_m
        elif self._task is None or length(target_m - self._task) > config.growth_m:
            self._task = target_m
            self.restart()

    def restart(self) -> None:
        """Begin anew: a start, or another target."""
        self._smooth_m: float | None = None
        self._up_s = self._near_s = self._since_s = 0.0
        self._best = self._mark = _Mark(inf, None)  # least error; that at the last progress
        self._swung: _Mark | None = None
        self._swings_m, self._still_s, self._first_m = 0.0, 0.0, 0.0
        #: Predicted motion, m, where the object may move, too, since the error came down; from it.
        self.travel_m, self._high_m = 0.0, inf
        self.settled = False

    def add(
        self,
        error_m: np.ndarray,
        dt_s: float,
        servoing: bool,
        config: SupervisorConfig,
        target_m: np.ndarray | None = None,
    ) -> None:
        """Take the error, m, (d,), after a tick, and the target's position.

        The timers of growth, stall and swing run only while servoing. The target's own motion does
        not count as growth.
        """
        norm_m = length(error_m)
        if self._smooth_m is None:
            self._smooth_m = self._first_m = norm_m
        self._smooth_m += (norm_m - self._smooth_m) * dt_s / (dt_s + _SMOOTH_S)
        smooth_m = self._smooth_m
        self._near_s = self._near_s + dt_s if smooth_m < config.settled_error_m else 0.0
        self.settled = self._near_s >= config.settled_time_s
        if not servoing:
            return  # the timers pause: a short gap in the inputs must not reset them
        self._swing(error_m, dt_s, target_m)
        best_m = float(self._best.error) + self._best.gone_m(target_m)
        if smooth_m < best_m:
            self._best, best_m = _Mark(smooth_m, target_m), smooth_m
        up = smooth_m > config.growth_factor * best_m and smooth_m > best_m + config.growth_m
        self._up_s = self._up_s + dt_s if up else 0.0
        mark_m = float(self._mark.error) + self._mark.gone_m(target_m)
        if best_m < _PROGRESS * mark_m:
            self._mark, self._since_s = _Mark(best_m, target_m), 0.0
        elif smooth_m > config.stall_error_m:
            self._since_s += dt_s
        else:
            self._since_s = 0.0
        if smooth_m < max(_DOWN * self._high_m, config.settled_error_m):
            self._high_m, self.travel_m = smooth_m, 0.0
        self._high_m = max(self._high_m, smooth_m)

    def _swing(self, error_m: np.ndarray, dt_s: float, target_m: np.ndarray | None) -> None:
        if self._swung is None:
            self._swung = _Mark(error_m, target_m)
        went_m = length(error_m - self._swung.error)
        self._still_s += dt_s
        if went_m > _SWING_M:
            self._swings_m += max(0.0, went_m - self._swung.gone_m(target_m))
            self._swung, self._still_s = _Mark(error_m, target_m), 0.0
        elif self._still_s > _REST_S:
            self._swings_m = self._first_m = 0.0
            self._swung = _Mark(error_m, target_m)

    def check(self, config: SupervisorConfig, remark: str = "") -> Finding | None:
        """Find an error that grows, swings or stalls; a remark follows the sentence."""
        text, error_m = config.kind.length_text, inf if self._smooth_m is None else self._smooth_m
        if self._up_s >= config.growth_time_s:
            return Reason.ERROR_GROWING.because(
                best=text(float(self._best.error)),
                error=text(error_m),
                time_s=config.growth_time_s,
                remark=remark,
            )
        if self._swings_m > _SWINGS_M + 2.0 * self._first_m:
            return Reason.OSCILLATING.because(what=config.kind.what, distance=text(self._swings_m))
        # An image that stands may be that of a moving object. The arm would have gained on it by
        # then: one error's length to match its speed, one to close the gap.
        astray = self.travel_m > 2.0 * error_m + config.prediction_hold_m
        if astray or self._since_s >= config.stall_time_s:
            time = f"{config.stall_time_s:.0f} s"
            during = f"{text(self.travel_m)} of motion" if astray else time
            return Reason.STALLED.because(during=during, error=text(error_m), remark=remark)
        return None


class Goal:
    """Holds the target, which must be inside the workspace, and monitors the error to it."""

    def __init__(self, config: SupervisorConfig) -> None:
        self._config = config
        self.progress = Progress()  #: of the error since the start, or since another target
        self._followed = TargetMotions(config.kind)
        self._now_m = self._followed.path_m  # the path up to the target now
        self.moving = False  #: whether the target that was set last continues a motion
        self.target: np.ndarray | None = None  #: the target now, (m,)
        self.speed = 1.0  #: share of the speed limits that this target may use
        self.reference = ""  #: name of the taught reference that the target is
        self.velocity_m_s: np.ndarray | None = None  #: the target's, (d,); None unless it moves
        self.z: np.ndarray | None = None  #: the feature now, (m,)
        #: Feature and target that the error was found for.
        self._error_of: tuple[np.ndarray | None, np.ndarray | None] = None, None
        self._error_m: np.ndarray | None = None
        self._parts: list[np.ndarray | None] = [None for _ in config.kind.parts]

    def configure(self, config: SupervisorConfig) -> None:
        """Change the settings; a target that a new box leaves outside is dropped."""
        self._config = config
        held = (self.target, self._followed.last)
        if any(target is not None and self._outside(target) for target in held):
            self.forget()

    def forget(self) -> None:
        """Have no target; the next one is another task, wherever it is."""
        self.target, self._parts = None, [None for _ in self._parts]
        self._followed.forget()
        self.progress = Progress()

    def whole(self, part: np.ndarray, camera: int) -> np.ndarray | None:
        """The target, (m,), with a camera's new part; None while another camera has none."""
        if self.target is not None:
            self._parts = [self.target[rows] for rows in self._config.kind.rows]
        elif len(self._parts) == 1:
            return part
        self._parts[camera] = part
        known = [each for each in self._parts if each is not None]
        return np.concatenate(known) if len(known) == len(self._parts) else None

    @property
    def awaited(self) -> str:
        """Topics on which there is no target yet, in words."""
        names = [kind.topics.target.name for kind in self._config.kind.parts]
        parts = zip(self._parts, names, strict=True)
        return " and ".join([name for part, name in parts if part is None] or names)

    @property
    def rests(self) -> bool:
        """Whether the target has stood for a while, as far as its updates tell."""
        return self._followed.rests

    def _refusal(self, target: np.ndarray, frame: str) -> str:
        """Why a target, (m,), is not accepted in this frame; empty if it is."""
        expected, numbers = self._config.feature_frame, self._config.kind.numbers
        if not frame:
            return f"it names no frame; set header.frame_id to {expected}"
        if frame != expected:
            return f"it is in frame {frame}, expected {expected} (feature_frame)"
        if np.shape(target) != (numbers,) or not np.isfinite(target).all():
            return f"expected {numbers} finite numbers, got {target}"
        outside = self._outside(np.asarray(target, dtype=float))
        return f"{outside}, in {frame}" if outside else ""

    def set(
        self,
        target: np.ndarray,
        frame: str,
        there_s: float = -inf,
        age_s: float = 0.0,
        camera: int | None = None,
    ) -> tuple[bool, str]:
        """Set the target, (m,); a refused one leaves the old in place.

        ``there_s`` is its time on the joint states' clock, s; a target soon after the last one is
        a moving one. Without a time it is fixed. ``age_s`` is the age of its message. Of a camera,
        only its part is new. Returns whether it was accepted, and a text with the result or the
        reason for the refusal.
        """
        refusal = self._refusal(target, frame)
        if refusal:
            return False, f"target refused: {refusal}"
        target = np.array(target, dtype=float)
        update = self._followed.add(target, there_s, age_s, camera)
        if update is Update.OVERTAKEN:
            return True, "target ignored: a newer one has arrived"
        path_m = self._followed.path_m
        self.moving = update is Update.CONTINUED
        self.progress.take_target(path_m, self._config, self.moving)
        if not self.moving:
            self._error_of, self._error_m = (None, None), None  # its direction is of another task
        self.target, self._now_m = target, path_m
        return True, f"target set to {self._config.kind.text(target)}"

    def move_on(self, now_s: float) -> None:
        """Move a moving target to where it is now, s; at the workspace's end it stays."""
        target, now_m, self.velocity_m_s = self._followed.at(now_s)
        if target is None or not self._outside(target):
            self.target, self._now_m = target, now_m
        else:
            self.velocity_m_s = None

    def off_m(self, target: np.ndarray, there_s: float) -> np.ndarray | None:
        """How far a measured target, (m,), is from where it was expected then, s, m, (d,).

        None where nothing was expected, or where that is within its noise.
        """
        expected, _, _ = self._followed.at(there_s)
        if expected is None:
            return None
        off_m = self._config.kind.minus(target, expected)
        least_m = OUTLIER * self._followed.noise_m + GATE_M
        return off_m if length(off_m) > len(off_m) ** 0.5 * least_m else None

    def see(self, z: np.ndarray | None, dt_s: float, servoing: bool) -> None:
        """Take the feature after a tick, (m,); None if it is unknown."""
        self.z = z
        error = self.error_m
        if error is not None:
            self.progress.add(error, dt_s, servoing, self._config, self._now_m)

    @property
    def error_m(self) -> np.ndarray | None:
        """Feature from target, m, shape (d,), or None where one of them is unknown."""
        z, target = self.z, self.target
        if z is None or target is None:
            return None
        if self._error_of[0] is not z or self._error_of[1] is not target:
            self._error_of = z, target
            self._error_m = self._config.kind.error(z, target, self._error_m)
        return self._error_m

    def _outside(self, target: np.ndarray) -> str:
        """Say how a target is out of the workspace box, or of the view of a camera on the arm."""
        config, kind = self._config, self._config.kind
        low, high = config.workspace_min_m, config.workspace_max_m
        axes = kind.axes[: kind.box_size]
        outside = [
            f"{axis} = {value:.3f} m is not in [{lo:g}, {hi:g}]"
            for axis, value, lo, hi in zip(axes, target.tolist(), low, high, strict=False)
            if not lo <= value <= hi
        ]
        if outside:
            return f"{', '.join(outside)} (workspace_min_m and workspace_max_m)"
        return config.out_of_view(kind, target) if kind.on_arm else kind.unseen(target)
