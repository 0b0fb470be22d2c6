"""The outcome of a run: its figures, and its row in the tidy table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fvs_controller_node.reasons import State
from fvs_controller_node.supervisor import Command
from fvs_tools.score import (
    FINAL_S,
    FINE_ERROR_M,
    SETTLED_ERROR_M,
    jitter_rad_s,
    settling_time_s,
)

#: Ticks between comparisons of the Jacobian in use with the true one.
JACOBIAN_EVERY = 5


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
    #: ``time_s`` (n,), ``feature_m`` and ``exponent`` (n, m), ``error_m`` (n,), ``command_rad_s``
    #: (n, joints); empty unless recorded.
    series: dict[str, np.ndarray] = field(default_factory=dict)

    def row(self, **labels: Any) -> dict[str, Any]:
        """A row of the tidy table: labels, then ``settled`` and all fields."""
        return {**labels, "settled": not self.failure, **vars(self)}


def outcome_of(
    times_s: np.ndarray,
    features_m: np.ndarray,
    errors_m: np.ndarray,
    target_m: np.ndarray,
    commands: Sequence[Command],
    jacobian_errors: np.ndarray,
    record: bool,
) -> Outcome:
    """Judge a run of n ticks.

    Times since the target was given, s, and errors from it, m, shape (n,); features, m, (n, m),
    and the last target, m, (m,), in the camera frame; errors of the Jacobian of every
    ``JACOBIAN_EVERY``-th tick. ``record`` keeps the time series.
    """
    speeds = np.array([command.velocity_rad_s for command in commands])
    settled_s, fine_s = (
        float("inf") if (time_s := settling_time_s(times_s, errors_m, bound)) is None else time_s
        for bound in (SETTLED_ERROR_M, FINE_ERROR_M)
    )
    last = times_s > times_s[-1] - FINAL_S
    moving = times_s <= settled_s
    serving = commands[-1].state is State.SERVOING
    series = {}
    if record:
        outputs = [command.output for command in commands]
        exponents = [None if output is None else output.exponent for output in outputs]
        known = next((exponent for exponent in exponents if exponent is not None), np.empty(0))
        unknown = np.full_like(known, np.nan)
        series = {
            "time_s": times_s,
            "feature_m": features_m,
            "error_m": errors_m,
            "command_rad_s": speeds,
            "exponent": np.array(
                [unknown if exponent is None else exponent for exponent in exponents]
            ),
        }
    return Outcome(
        to_5mm_s=settled_s,
        to_2mm_s=fine_s,
        start_distance_m=float(errors_m[0]),
        final_rms_m=float(np.sqrt(np.mean(errors_m[last] ** 2))),
        jitter_rad_s=jitter_rad_s(speeds[last]) if serving else float("inf"),
        peak_joint_speed_rad_s=float(np.abs(speeds).max()),
        limited_share=float(
            np.mean([bool(command.active_limit) for command in commands], where=moving)
        ),
        jacobian_error=float(np.mean(jacobian_errors[moving[::JACOBIAN_EVERY]])),
        failure="" if np.isfinite(settled_s) else _cause(times_s, errors_m, commands[-1]),
        target_m=tuple(target_m.tolist()),
        series=series,
    )


def _cause(times_s: np.ndarray, errors_m: np.ndarray, end: Command) -> str:
    """Why a run did not settle."""
    if end.state is not State.SERVOING:
        return f"held: {end.reason.name.lower().replace('_', ' ')}"
    if errors_m[times_s > times_s[-1] - FINAL_S].min() < SETTLED_ERROR_M:
        return "reached 5 mm, but did not stay"
    return "too slow" if errors_m[-1] < 0.9 * errors_m[0] else "did not get nearer"
