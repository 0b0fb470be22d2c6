"""The outcome of a run: its figures, and its row in the tidy table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fvs_controller_node.reasons import State
from fvs_controller_node.supervisor import Command
from fvs_tools.score import FINAL_S, FINE_ERROR_M, SETTLED_ERROR_M, jitter_rad_s, settling_time_s

#: Error bounds of the settling times, m.
BOUNDS_M = {"5 mm": SETTLED_ERROR_M, "2 mm": FINE_ERROR_M, "1 mm": 0.001}
#: Ticks between comparisons of the Jacobian in use with the true one.
JACOBIAN_EVERY = 5
#: Cause of a failure: the ball came near, and left again.
NOT_STAYED = "reached 5 mm, but did not stay"


@dataclass(frozen=True)
class Outcome:
    """The outcome of a trial; errors are those of the true ball position."""

    #: Error when the target was given, m.
    start_distance_m: float
    #: Time after which the error stayed below a bound, by the bound's name; None for never.
    settling_s: dict[str, float | None]
    #: Error over the last second, rms, m.
    final_rms_m: float
    #: Change of the command from tick to tick over the last second, rms, worst joint, rad/s;
    #: infinite for an arm that the supervisor held, since its rest is no merit of the law.
    jitter_rad_s: float
    #: Largest commanded joint speed, rad/s.
    peak_joint_speed_rad_s: float
    #: Length of the ball's path over the distance.
    path_ratio: float
    #: Share of the time to 5 mm (or the whole run) in which a limit shaped the command.
    limited_share: float
    #: Relative Frobenius error of the Jacobian that the controller used, mean until settled.
    jacobian_error: float
    #: Why it did not settle to 5 mm; empty if it did.
    failure: str
    #: The target, camera frame, m; after a bump, in the frame of the moved camera.
    target_m: tuple[float, ...]
    #: The controller's last status text in a run that failed.
    said: str = ""
    #: ``time_s`` (n,), ``ball_m`` and ``exponent`` (n, m), ``error_m`` (n,), ``command_rad_s``
    #: (n, joints); empty unless recorded.
    series: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def settled_s(self) -> float:
        """Settling time to 5 mm, s; infinite if never."""
        return seconds(self.settling_s["5 mm"])

    def row(self, **labels: Any) -> dict[str, Any]:
        """A row of the tidy table: labels, then ``settled``, ``to_5mm_s`` and all fields.

        A settling time that was never reached is infinite.
        """
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        times = values.pop("settling_s")
        to = {f"to_{name.replace(' ', '')}_s": seconds(time) for name, time in times.items()}
        return {**labels, "settled": not self.failure, **to, **values}


def seconds(value: float | None) -> float:
    """A settling time as a number: infinite for never."""
    return float("inf") if value is None else value


def outcome_of(
    times_s: np.ndarray,
    balls_m: np.ndarray,
    errors_m: np.ndarray,
    targets_m: np.ndarray,
    commands: Sequence[Command],
    jacobian_errors: np.ndarray,
    record: bool,
) -> Outcome:
    """Judge a run of n ticks.

    Times since the target was given, s, and errors from it, m, shape (n,); balls and targets in the
    camera frame, m, shape (n, m); errors of the Jacobian of every ``JACOBIAN_EVERY``-th tick.
    ``record`` keeps the time series.
    """
    speeds = np.array([one.velocity_rad_s for one in commands])
    settling = {name: settling_time_s(times_s, errors_m, bound) for name, bound in BOUNDS_M.items()}
    last = times_s > times_s[-1] - FINAL_S
    settled = settling["5 mm"]
    moving = times_s <= (times_s[-1] if settled is None else settled)
    failure = "" if settled is not None else _cause(errors_m, commands)
    steps_m = np.linalg.norm(np.diff(balls_m[moving], axis=0), axis=1)
    # A bump moves the camera, not the ball.
    steps_m[np.diff(targets_m[moving], axis=0).any(axis=1)] = 0.0
    limited = np.array([bool(one.active_limit) for one in commands])
    serving = commands[-1].state is State.SERVOING
    given = [one.output.exponent for one in commands if one.output is not None]
    nothing = np.full(given[0].size if given else 0, np.nan)
    exponents = [nothing if one.output is None else one.output.exponent for one in commands]
    return Outcome(
        start_distance_m=float(errors_m[0]),
        settling_s=settling,
        final_rms_m=float(np.sqrt(np.mean(errors_m[last] ** 2))),
        jitter_rad_s=jitter_rad_s(speeds[last]) if serving else float("inf"),
        peak_joint_speed_rad_s=float(np.abs(speeds).max()),
        path_ratio=float(steps_m.sum()) / float(errors_m[0]),
        limited_share=float(np.mean(limited[moving])),
        jacobian_error=float(np.mean(jacobian_errors[moving[::JACOBIAN_EVERY]])),
        failure=failure,
        target_m=tuple(float(value) for value in targets_m[-1]),
        said=commands[-1].text if failure else "",
        series={
            "time_s": times_s,
            "ball_m": balls_m,
            "error_m": errors_m,
            "command_rad_s": speeds,
            "exponent": np.array(exponents),
        }
        if record
        else {},
    )


def _cause(errors_m: np.ndarray, commands: Sequence[Command]) -> str:
    """Why a run did not settle."""
    if commands[-1].state is not State.SERVOING:
        return f"held: {commands[-1].reason.name.lower().replace('_', ' ')}"
    if errors_m[-125:].min() < BOUNDS_M["5 mm"]:
        return NOT_STAYED
    return "too slow" if errors_m[-1] < 0.9 * errors_m[0] else "did not get nearer"
