"""What came of a run: its record, its judgement, and its row in the tidy table."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fvs_controller_node.reasons import State
from fvs_controller_node.supervisor import Command
from fvs_tools.score import jitter_rad_s, settling_time_s

#: Errors whose settling times are taken, m.
BOUNDS_M = {"5 mm": 0.005, "2 mm": 0.002, "1 mm": 0.001}

#: Ticks from one comparison of the Jacobian in use with the true one to the next.
JACOBIAN_EVERY = 5
#: The end of a run, over which rest is judged, s.
REST_S = 1.0
#: Cause of a failure: the ball came near, and left again.
NOT_STAYED = "reached 5 mm, but did not stay"


@dataclass(frozen=True)
class Outcome:
    """What came of a trial; errors are of the true ball position.

    Parameters
    ----------
    start_distance_m : float
        Error when the target was given, m.
    settling_s : dict of str to (float or None)
        Time after which the error stayed below a bound, by the bound's name; None for never.
    final_rms_m : float
        Error over the last second, rms, m.
    jitter_rad_s : float
        Change of the command from tick to tick over the last second, rms, worst joint, rad/s;
        infinite for an arm that the supervisor held: standing still is not calm.
    peak_joint_speed_rad_s : float
        Largest commanded joint speed, rad/s.
    path_ratio : float
        Length of the ball's path over the distance.
    limited_share : float
        Share of the time to 5 mm (or the whole run) in which a limit shaped the command.
    jacobian_error : float
        Relative Frobenius error of the Jacobian that the controller used, mean until settled.
    failure : str
        Why it did not settle to 5 mm; empty if it did.
    target_m : tuple of 3 float
        The target, camera frame, m; after a bump, that of the camera where it is then.
    said : str
        What the controller said last in a run that failed.
    series : dict of str to ndarray
        ``time_s`` (n,), ``ball_m`` (n, 3), ``error_m`` (n,), ``command_rad_s`` (n, 6),
        ``exponent`` (n, 3); empty unless recorded.
    """

    start_distance_m: float
    settling_s: dict[str, float | None]
    final_rms_m: float
    jitter_rad_s: float
    peak_joint_speed_rad_s: float
    path_ratio: float
    limited_share: float
    jacobian_error: float
    failure: str
    target_m: tuple[float, ...]
    said: str = ""
    series: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def settled_s(self) -> float:
        """Settling time to 5 mm, s; infinite if never."""
        return seconds(self.settling_s["5 mm"])

    def row(self, **labels: Any) -> dict[str, Any]:
        """A row of the tidy table: labels, then ``settled``, ``to_5mm_s`` and all fields.

        Settling times are infinite for never.
        """
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        times = values.pop("settling_s")
        to = {_column(name): seconds(time) for name, time in times.items()}
        return {**labels, "settled": not self.failure, **to, **values}


def settling_columns(times_s: np.ndarray, errors_m: np.ndarray) -> dict[str, float]:
    """Settling times to all bounds as columns of the tidy table, s; infinite for never."""
    return {
        _column(name): seconds(settling_time_s(times_s, errors_m, bound_m))
        for name, bound_m in BOUNDS_M.items()
    }


def _column(bound: str) -> str:
    """``to_5mm_s`` for ``5 mm``."""
    return f"to_{bound.replace(' ', '')}_s"


def seconds(value: float | None) -> float:
    """A settling time as a number: infinite for never."""
    return float("inf") if value is None else value


class RunLog:
    """Collects a run and judges it.

    Parameters
    ----------
    start_s : float
        When the target was given, s.
    """

    def __init__(self, start_s: float) -> None:
        self._start_s = start_s
        self._time_s: list[float] = []
        self._ball_m: list[np.ndarray] = []
        self._target_m: list[np.ndarray] = []
        self._command: list[np.ndarray] = []
        self._exponent: list[np.ndarray] = []
        self._limited: list[bool] = []
        self._jacobian_error: list[float] = []
        self._below_since_s: float | None = None
        self._last: Command | None = None
        self._held: str = ""

    def add_jacobian_error(self, error: float) -> None:
        """Add a comparison of the Jacobian in use with the true one."""
        self._jacobian_error.append(error)

    def add(self, now_s: float, ball_m: np.ndarray, target_m: np.ndarray, command: Command) -> None:
        """Add a tick: ball and target in the camera frame, m, and what was commanded."""
        self._time_s.append(now_s - self._start_s)
        self._ball_m.append(ball_m)
        self._target_m.append(target_m)
        self._command.append(command.velocity_rad_s)
        output = command.output
        self._exponent.append(np.full_like(ball_m, np.nan) if output is None else output.exponent)
        self._limited.append(bool(command.active_limit))
        self._last = command
        if command.state is not State.SERVOING:
            self._held = command.reason.name.lower().replace("_", " ")

    def rested_s(self) -> float:
        """How long the error has been below 5 mm, s."""
        now_s = self._time_s[-1]
        if np.linalg.norm(self._ball_m[-1] - self._target_m[-1]) >= BOUNDS_M["5 mm"]:
            self._below_since_s = None
            return 0.0
        if self._below_since_s is None:
            self._below_since_s = now_s
        return now_s - self._below_since_s

    def outcome(self, record: bool) -> Outcome:
        """Judge the run; ``record`` keeps its time series."""
        times, balls = np.array(self._time_s), np.array(self._ball_m)
        commands, targets = np.array(self._command), np.array(self._target_m)
        errors = np.linalg.norm(balls - targets, axis=1)
        settling = {
            name: settling_time_s(times, errors, bound_m) for name, bound_m in BOUNDS_M.items()
        }
        last = times > times[-1] - REST_S
        settled = settling["5 mm"]
        moving = times <= (times[-1] if settled is None else settled)
        failure = "" if settled is not None else self._cause(errors)
        steps_m = np.linalg.norm(np.diff(balls[moving], axis=0), axis=1)
        # A bump moves the camera, not the ball.
        steps_m[np.diff(targets[moving], axis=0).any(axis=1)] = 0.0
        series = {}
        if record:
            series = {
                "time_s": times,
                "ball_m": balls,
                "error_m": errors,
                "command_rad_s": commands,
                "exponent": np.array(self._exponent),
            }
        return Outcome(
            start_distance_m=float(errors[0]),
            settling_s=settling,
            final_rms_m=float(np.sqrt(np.mean(errors[last] ** 2))),
            jitter_rad_s=self._jitter(commands[last]),
            peak_joint_speed_rad_s=float(np.abs(commands).max()),
            path_ratio=float(steps_m.sum()) / float(errors[0]),
            limited_share=float(np.mean(np.array(self._limited)[moving])),
            jacobian_error=float(np.mean(np.array(self._jacobian_error)[moving[::JACOBIAN_EVERY]])),
            failure=failure,
            target_m=tuple(float(value) for value in targets[-1]),
            said=self._last.text if failure and self._last is not None else "",
            series=series,
        )

    def _jitter(self, commands: np.ndarray) -> float:
        if self._last is None or self._last.state is not State.SERVOING:
            return float("inf")
        return jitter_rad_s(commands)

    def _cause(self, errors: np.ndarray) -> str:
        if self._last is not None and self._last.state is not State.SERVOING:
            return f"held: {self._held}"
        if errors[-125:].min() < BOUNDS_M["5 mm"]:
            return NOT_STAYED
        if errors[-1] < 0.9 * errors[0]:
            return "too slow"
        return "did not get nearer"
