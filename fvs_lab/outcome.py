"""The outcome of a run: its figures, and its row in the tidy table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from fvs_controller_node.reasons import State
from fvs_controller_node.supervisor import Command
from fvs_tools.score import FINAL_S, FINE_ERROR_M, SETTLED_ERROR_M, jitter_rad_s, settling_time_s

#: Error bounds of the settling times, m, by the ends of their columns.
BOUNDS_M = {"5mm": SETTLED_ERROR_M, "2mm": FINE_ERROR_M}
#: Ticks between comparisons of the Jacobian in use with the true one.
JACOBIAN_EVERY = 5
#: Cause of a failure: the ball came near, and left again.
NOT_STAYED = "reached 5 mm, but did not stay"


@dataclass(frozen=True)
class Outcome:
    """The outcome of a trial; errors are those of the true ball position."""

    #: Time after which the error stayed below a bound, s; infinite for never.
    to_5mm_s: float
    to_2mm_s: float
    #: Error when the target was given, and over the last second, rms, m.
    start_distance_m: float
    final_rms_m: float
    #: Change of the command from tick to tick over the last second, rms, worst joint, rad/s;
    #: infinite for an arm that the supervisor held, since its rest is no merit of the law.
    jitter_rad_s: float
    #: Largest commanded joint speed, rad/s.
    peak_joint_speed_rad_s: float
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

    def row(self, **labels: Any) -> dict[str, Any]:
        """A row of the tidy table: labels, then ``settled`` and all fields."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        return {**labels, "settled": not self.failure, **values}


def seconds(value: float | None) -> float:
    """A settling time as a number: infinite for never."""
    return float("inf") if value is None else value


def outcome_of(
    times_s: np.ndarray,
    balls_m: np.ndarray,
    errors_m: np.ndarray,
    target_m: np.ndarray,
    commands: Sequence[Command],
    jacobian_errors: np.ndarray,
    record: bool,
) -> Outcome:
    """Judge a run of n ticks.

    Times since the target was given, s, and errors from it, m, shape (n,); balls, m, (n, m), and
    the last target, m, (m,), in the camera frame; errors of the Jacobian of every
    ``JACOBIAN_EVERY``-th tick. ``record`` keeps the time series.
    """
    speeds = np.array([one.velocity_rad_s for one in commands])
    settled_s, fine_s = (
        seconds(settling_time_s(times_s, errors_m, bound)) for bound in BOUNDS_M.values()
    )
    last = times_s > times_s[-1] - FINAL_S
    moving = times_s <= settled_s
    failure = "" if np.isfinite(settled_s) else _cause(errors_m, commands)
    serving = commands[-1].state is State.SERVOING
    series = {}
    if record:
        exponents = [None if one.output is None else one.output.exponent for one in commands]
        known = [one for one in exponents if one is not None]
        unknown = np.full_like(known[0] if known else np.empty(0), np.nan)
        series = {
            "time_s": times_s,
            "ball_m": balls_m,
            "error_m": errors_m,
            "command_rad_s": speeds,
            "exponent": np.array([unknown if one is None else one for one in exponents]),
        }
    return Outcome(
        to_5mm_s=settled_s,
        to_2mm_s=fine_s,
        start_distance_m=float(errors_m[0]),
        final_rms_m=float(np.sqrt(np.mean(errors_m[last] ** 2))),
        jitter_rad_s=jitter_rad_s(speeds[last]) if serving else float("inf"),
        peak_joint_speed_rad_s=float(np.abs(speeds).max()),
        limited_share=float(np.mean([bool(one.active_limit) for one in commands], where=moving)),
        jacobian_error=float(np.mean(jacobian_errors[moving[::JACOBIAN_EVERY]])),
        failure=failure,
        target_m=tuple(target_m.tolist()),
        said=commands[-1].text if failure else "",
        series=series,
    )


def _cause(errors_m: np.ndarray, commands: Sequence[Command]) -> str:
    """Why a run did not settle."""
    if commands[-1].state is not State.SERVOING:
        return f"held: {commands[-1].reason.name.lower().replace('_', ' ')}"
    if errors_m[-125:].min() < BOUNDS_M["5mm"]:
        return NOT_STAYED
    return "too slow" if errors_m[-1] < 0.9 * errors_m[0] else "did not get nearer"
