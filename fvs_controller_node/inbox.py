"""The inputs: each message is checked once, and each input watched for its age."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from math import inf, isfinite
from statistics import median

import numpy as np

from fvs_controller_node.config import SupervisorConfig
from fvs_controller_node.reasons import Finding, Reason
from fvs_ros.timeline import MAX_LATENCY_S
from fvs_ros.vectors import LARGEST, plausible

#: Inputs, by the names of their topics but for the feature.
JOINT_STATES, FEATURE, JACOBIAN, OBJECT = "joint_states", "feature", "jacobian", "object"
SPEED_SCALING, ROBOT_DESCRIPTION = "speed_scaling", "robot_description"

#: Largest age of a source's status, and duration of a conflict after the foreign command, s.
_STATUS_MAX_AGE_S, _CONFLICT_S = 2.0, 1.0
#: An image of a slow camera is late after this many of its periods, so that one may be lost; the
#: period is the median of some intervals, at least and at most.
_PERIODS, _FEWEST, _MOST = 2.5, 5, 9


class InputMonitor:
    """Monitors the arrival of one input on the steady clock.

    A fault (missing, stale, unusable) lasts until ``fresh_samples`` consecutive good messages.
    ``hint`` names what to check while messages are missing. ``limit`` names the parameter with
    the largest age; it is empty for an input that may come rarely or never.
    """

    #: An input that comes slowly may be older, up to this, s.
    slow_s = 0.0
    #: Whether it counts now.
    needed = True
    #: How much older it may be now, s.
    spare_s = 0.0

    def __init__(
        self, config: SupervisorConfig, name: str, hint: str = "", limit: str = ""
    ) -> None:
        self.config, self.name, self._hint, self._limit = config, name, hint, limit
        self._intervals_s, self._periods_s = deque[float](maxlen=_MOST), 0.0
        self._last_s: float | None = None
        self._streak = 0
        self._trouble = Reason.MISSING if limit else None
        self._why = ""
        self._stuck_s = self._source_s = -inf
        self._source_status = ""

    def good(self, now_s: float) -> None:
        """Count a usable message."""
        self.find(now_s)  # a gap since the last one counts, even if no tick saw it
        if self._last_s is not None:
            self._intervals_s.append(now_s - self._last_s)
        if self.slow_s and len(self._intervals_s) >= _FEWEST:
            self._periods_s = min(_PERIODS * median(self._intervals_s), self.slow_s)
        self._last_s = now_s
        if self._trouble is not None:
            self._streak += 1
            if self._streak >= self.config.fresh_samples:
                self._trouble = None

    def stuck(self, now_s: float) -> None:
        """Note a message whose stamp does not advance; it does not count."""
        self._stuck_s = now_s

    def set_source_status(self, now_s: float, why: str) -> None:
        """Store the estimator's reason for sending nothing; empty without one."""
        self._source_status, self._source_s = why, now_s

    def bad(self, why: str) -> None:
        """Note a message that cannot be used."""
        self._streak, self._trouble, self._why = 0, Reason.BAD_INPUT, why

    def forget(self) -> None:
        """Clear the fault of an optional input that has ended."""
        self._trouble = None

    def age_s(self, now_s: float) -> float:
        """Time since the last usable message, s; infinite if there was none."""
        return inf if self._last_s is None else max(0.0, now_s - self._last_s)

    def _largest_age(self) -> tuple[str, float]:
        """What limits the age of a message, and the limit, s."""
        limit_s = getattr(self.config, self._limit) if self._limit else inf
        if limit_s < self._periods_s:
            return f"{_PERIODS:g} of its periods", self._periods_s
        return self._limit, limit_s

    def late(self, now_s: float) -> bool:
        """Whether the last usable message is too old, but for the time to spare."""
        return self.age_s(now_s) > self._largest_age()[1]

    def find(self, now_s: float) -> Finding | None:
        """Find what is wrong with this input now, if anything."""
        age_s = self.age_s(now_s)
        limit, limit_s = self._largest_age()
        limit_s += self.spare_s
        stale = self._last_s is not None and age_s > limit_s
        if stale:
            self._streak = 0
            self._trouble = self._trouble or Reason.STALE
        if self._trouble is None or not self.needed:
            return None
        numbers = {"name": self.name, "count": self._streak, "wanted": self.config.fresh_samples}
        if self._trouble is Reason.BAD_INPUT:
            return Reason.BAD_INPUT.because(why=self._why, **numbers)
        hint = self._hint
        if self._source_status and now_s - self._source_s <= _STATUS_MAX_AGE_S:
            hint = f"the estimator says: {self._source_status}"
        elif now_s - self._stuck_s <= limit_s:
            hint = "messages come, but their stamps do not advance: its source has frozen"
        if stale:
            return Reason.STALE.because(
                name=self.name, age_s=age_s, limit=limit, limit_s=limit_s, hint=hint
            )
        if self._trouble is Reason.MISSING:
            return Reason.MISSING.because(hint=hint, **numbers)
        return Reason.RETURNING.because(**numbers)


class Inbox:
    """All inputs of the supervisor.

    ``end_session`` is called with the reason why a session must end now: a pause of the robot,
    another node's command.
    """

    def __init__(self, config: SupervisorConfig, end_session: Callable[[Finding], None]) -> None:
        self._config, self._end_session = config, end_session
        kind = config.kind
        #: Inputs of the cameras.
        self.features = tuple(f"{FEATURE} {name}".strip() for name in kind.cameras)
        seen = f"is the {kind.what} in view, and the detector running?"
        hints = {
            JOINT_STATES: ("is the robot driver (or simulator) running?", "joint_states_max_age_s"),
            **dict.fromkeys(self.features, (seen, "ball_max_age_s")),
            JACOBIAN: ("is the estimator running?", "jacobian_max_age_s"),
            OBJECT: ("is the object in view, and its detector running?", "ball_max_age_s"),
            **dict.fromkeys((SPEED_SCALING, ROBOT_DESCRIPTION), ()),
        }
        features = zip(self.features, (part.feature.name for part in kind.parts), strict=True)
        names = {OBJECT: kind.topics.object.name, **dict(features)}
        self._monitors = {
            key: InputMonitor(config, names.get(key, key), *words) for key, words in hints.items()
        }
        for name in (*self.features, OBJECT):
            self[name].slow_s = MAX_LATENCY_S  # longer, none is predicted
        self[OBJECT].needed = False
        #: Cameras that do not count now, as another sees, and why, where that is not their age.
        self.lost: dict[int, str] = {}
        self._conflict: Finding | None = None  # with another node, and when it commanded last
        self._conflict_s = -inf
        self._program_running: bool | None = None  # never reported
        self._speed_scaling = 100.0
        self._pauses: list[Finding] = []  # of the robot, now

    def __getitem__(self, topic: str) -> InputMonitor:
        """The monitor of an input."""
        return self._monitors[topic]

    def configure(self, config: SupervisorConfig) -> None:
        """Change what is expected while running."""
        self._config = config
        for monitor in self._monitors.values():
            monitor.config = config

    # ---- messages ---------------------------------------------------------------------------

    def add(self, name: str, now_s: float, values: np.ndarray) -> bool:
        """Take joints, (n,), rad, a camera's feature or object, (m,), or Jacobian, (d, n).

        False if bad.
        """
        values, kind = np.asarray(values, dtype=float), self._config.kind
        n, weights = len(self._config.joint_names), kind.parts[0].weights
        shape = {JOINT_STATES: (n,), JACOBIAN: (kind.size, n)}.get(name, weights.shape)
        fits = values.shape == shape
        if fits and plausible(values if name in (JOINT_STATES, JACOBIAN) else weights * values):
            self[name].good(now_s)
            return True
        wanted = " x ".join(map(str, shape))
        self[name].bad(
            f"expected {wanted} finite numbers, up to {LARGEST:g} m or rad, "
            f"got {values.tolist() if fits else f'shape {values.shape}'}"
        )
        return False

    def add_program_running(self, running: bool) -> None:
        """Take whether the robot's program runs."""
        self._program_running = bool(running)
        self._pause()

    def add_speed_scaling(self, now_s: float, percent: float) -> None:
        """Take the robot's speed scaling, 0 to 100 %."""
        if not isfinite(percent):
            self[SPEED_SCALING].bad(f"expected 0 to 100, got {percent}")
            return
        self[SPEED_SCALING].good(now_s)
        self._speed_scaling = float(percent)
        self._pause()

    def conflicting_command(self, now_s: float, name: str) -> None:
        """Note that another node has just commanded the arm, too."""
        self._conflict, self._conflict_s = Reason.CONFLICT.because(name=name), now_s
        self._end_session(self._conflict)

    def _pause(self) -> None:
        stopped, slow = self._program_running is False, self._speed_scaling <= 0.0
        pauses = (Reason.PROGRAM_STOPPED, stopped), (Reason.SPEED_SCALING_ZERO, slow)
        self._pauses = [pause.because() for pause, holds in pauses if holds]
        for pause in self._pauses:
            self._end_session(pause)

    # ---- what is wrong with them --------------------------------------------------------------

    def find(self, now_s: float) -> Finding | None:
        """Find what is wrong with the inputs now, worst first."""
        troubles = self._troubles(now_s, but=[self.features[camera] for camera in self.lost])
        # What must stop at once comes before a conflict, in which the arm may ramp to rest.
        findings = [finding for finding in troubles if finding.reason is Reason.BAD_INPUT]
        findings += self._pauses
        if self._conflict is not None and now_s - self._conflict_s < _CONFLICT_S:
            findings.append(self._conflict)
        findings += troubles
        return findings[0] if findings else None

    def may_leave(self, camera: int, now_s: float, shows: bool) -> bool:
        """Whether a camera shows nothing, has fallen silent or is not back yet; not a bad one."""
        finding = self[self.features[camera]].find(now_s)
        return not shows if finding is None else finding.reason is not Reason.BAD_INPUT

    def late(self, now_s: float) -> str:
        """The first fault in age or content of all messages but an object's; empty if fresh."""
        return next((finding.text for finding in self._troubles(now_s, but=[OBJECT])), "")

    def _troubles(self, now_s: float, but: Sequence[str]) -> list[Finding]:
        findings = [self[name].find(now_s) for name in self._monitors if name not in but]
        return [finding for finding in findings if finding is not None]

    @property
    def full_speed(self) -> bool:
        """Whether the robot obeys at its full speed."""
        # Not 100: the driver multiplies doubles.
        return self._program_running is not False and self._speed_scaling >= 99.5

    @property
    def speed_scaling(self) -> float:
        """Speed of the robot over the commanded one, 0 to 1."""
        return min(self._speed_scaling, 100.0) / 100.0

    def hidden(self, now_s: float) -> str:
        """That an object is hidden, or a camera is lost, and what counts; empty if neither is."""
        for camera, why in self.lost.items():
            feature = self[self.features[camera]]
            old = f"{feature.name} is {feature.age_s(now_s):.1f} s old"
            return f"{why or old}: the other cameras count"
        monitor, age_s = self[OBJECT], self[OBJECT].age_s(now_s)
        if not (monitor.needed and monitor.late(now_s)) or monitor.find(now_s) is not None:
            return ""
        return f"{monitor.name} is {age_s:.1f} s old: where the object stood counts"

    def status_values(self, now_s: float) -> dict[str, float | str]:
        """Ages and the robot's reports, always the same keys in the same order."""
        of_object = [OBJECT] * (not self._config.kind.on_arm)  # else it is the feature
        watched = [self[name] for name in (JOINT_STATES, *self.features, JACOBIAN, *of_object)]
        ages = {f"{monitor.name}_age_s": monitor.age_s(now_s) for monitor in watched}
        running = {None: "unknown", False: "false", True: "true"}[self._program_running]
        return {
            **ages,
            "robot_program_running": running,
            "speed_scaling_percent": self._speed_scaling,
        }
