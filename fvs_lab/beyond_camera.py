"""A camera that is turned far and moved: at a blow while the arm rests or moves, or carried."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fvs_lab.beyond_contestants import variant
from fvs_lab.disturbances import Bump
from fvs_lab.outcome import BOUNDS_M, seconds
from fvs_lab.results import Results
from fvs_lab.trials import PRELUDE_S, Case, Conditions, make_cases, simulation_of
from fvs_tools.closed_loop import ClosedLoop
from fvs_tools.score import settling_time_s

TURN_DEG, SHIFT_M = 45.0, 0.1
#: How far the axis of the turn is off the optical axis, a standard deviation of each part.
_TILT = 0.1
#: In motion the blow comes this time after the target, s.
STRUCK_AFTER_S = 0.3
#: How long the camera is carried, and how long the arm stands before and after, s.
CARRIED_S, _STOPPED_S = 2.0, 0.5
#: To the first target; at rest there after a blow; from the second target on, s.
_FIRST_S, REST_S, SECOND_S = 1.6, 1.0, 3.5
_VISIBLE = 0.9
#: A run after a blow to the camera keeps its pace if it takes no longer than this ratio.
KEPT = 1.2

UNDISTURBED, AT_REST, IN_MOTION = "undisturbed", "between two targets", "in mid-motion"
CARRIED = f"within {CARRIED_S:g} s while the arm is stopped"
#: When the camera moves; the first is never.
MOMENTS = (UNDISTURBED, AT_REST, CARRIED, IN_MOTION)


@dataclass(frozen=True)
class Journey:
    """From the goal of a case to its start, a rest, and back, with a blow to the camera.

    Parameters
    ----------
    name : str
        The contestant.
    case : Case
        The two ends, and the seed of the noise.
    bump : Bump
        How the camera moves; its time does not count.
    moment : str
        When it does, one of ``MOMENTS``.
    conditions : Conditions
        The world.
    """

    name: str
    case: Case
    bump: Bump
    moment: str
    conditions: Conditions


def draw_journeys(
    count: int, seed: int, names: Sequence[str], conditions: Conditions
) -> list[Journey]:
    """Draw cases and blows after which the ball is still seen; for each all moments and names.

    Parameters
    ----------
    count : int
        How many cases.
    seed : int
        Of the draw.
    names : sequence of str
        The contestants.
    conditions : Conditions
        The world.
    """
    rng = np.random.default_rng(seed)
    pairs: list[tuple[Case, Bump]] = []
    while len(pairs) < count:
        case = make_cases(f"C{len(pairs) + 1}-", 1, int(rng.integers(2**31)))[0]
        axis = np.append(_TILT * rng.normal(size=2), rng.choice([-1.0, 1.0]))
        shift = rng.normal(size=3)
        bump = Bump(STRUCK_AFTER_S, _vector(axis, TURN_DEG), _vector(shift, SHIFT_M))
        if _seen_after(bump, case):
            pairs.append((case, bump))
    return [
        Journey(name, case, bump, moment, conditions)
        for case, bump in pairs
        for moment in MOMENTS
        for name in names
    ]


def _vector(direction: np.ndarray, length: float) -> tuple[float, float, float]:
    x, y, z = (length * direction / np.linalg.norm(direction)).tolist()
    return (x, y, z)


def _seen_after(bump: Bump, case: Case) -> bool:
    """Whether the struck camera sees the ball at both ends and between them."""
    simulation = simulation_of(Conditions())
    bump.strike(simulation)
    between = 0.5 * (np.array(case.start_rad) + np.array(case.goal_rad))
    for joints in (case.start_rad, case.goal_rad, between):
        simulation.reset(joints)
        seen = simulation.look().detection
        if seen is None or seen.visible_fraction < _VISIBLE:
            return False
    return True


def run_journey(journey: Journey) -> dict[str, Any]:
    """Run one journey; the same to the bit in whatever process.

    Returns
    -------
    dict
        A row; ``to_5mm_s`` counts from the second target on.
    """
    simulation = simulation_of(journey.conditions)
    simulation.reset(journey.case.start_rad)
    first_m = simulation.world.ball_position()
    simulation.reset(journey.case.goal_rad, journey.case.seed)
    second_m = simulation.world.ball_position()
    loop = variant(journey.name).trial(journey.case, journey.conditions).loop(simulation)
    loop.run(PRELUDE_S)
    loop.set_target(simulation.camera.to_camera(first_m))
    loop.run(_FIRST_S)
    if journey.moment == AT_REST:
        journey.bump.strike(simulation)
        loop.set_target(simulation.camera.to_camera(first_m))
    elif journey.moment == CARRIED:
        _carry(journey.bump, loop)
        loop.set_target(simulation.camera.to_camera(first_m))
        accepted, _ = loop.loop.supervisor.start(simulation.time_s)
        if not accepted:  # the ball was lost on the way to the first target, as undisturbed
            return _row(journey, math.inf)
    loop.run(REST_S)
    loop.set_target(simulation.camera.to_camera(second_m))
    errors_m = []
    struck = round(STRUCK_AFTER_S / loop.period_s)
    for tick in range(round(SECOND_S / loop.period_s)):
        if tick == struck and journey.moment == IN_MOTION:
            journey.bump.strike(simulation)
            loop.set_target(simulation.camera.to_camera(second_m))
        loop.tick()
        errors_m.append(float(np.linalg.norm(simulation.world.ball_position() - second_m)))
    times_s = loop.period_s * np.arange(1, len(errors_m) + 1)
    settled_s = seconds(settling_time_s(times_s, np.array(errors_m), BOUNDS_M["5 mm"]))
    return _row(journey, settled_s)


def _row(journey: Journey, settled_s: float) -> dict[str, Any]:
    return {
        "part": "camera",
        "scheme": journey.name,
        "moment": journey.moment,
        "case": journey.case.name,
        "to_5mm_s": settled_s,
    }


def with_slowdown(arrivals: Results) -> Results:
    """Rows with ``slowdown``: settling time over that of the undisturbed run of the same case.

    From the last target on: in mid-motion that is the second one given anew, which is compared
    with what was left of the undisturbed run. Infinite where nothing was left, or the undisturbed
    run never settled. ``kept``: whether it is at most ``KEPT``.
    """
    calm = arrivals.where(moment=UNDISTURBED).groups("scheme", "case")
    rows = []
    for row in arrivals:
        before_s = STRUCK_AFTER_S if row["moment"] == IN_MOTION else 0.0
        left_s = calm[row["scheme"], row["case"]].rows[0]["to_5mm_s"] - before_s
        comparable = 0.0 < left_s < math.inf
        slowdown = (row["to_5mm_s"] - before_s) / left_s if comparable else math.inf
        rows.append({**row, "slowdown": slowdown, "kept": slowdown <= KEPT})
    return Results(rows)


def _carry(bump: Bump, loop: ClosedLoop) -> None:
    """Stop the arm and carry the camera evenly to where a blow would throw it."""
    loop.loop.supervisor.stop()
    loop.run(_STOPPED_S)
    ticks = round(CARRIED_S / loop.period_s)
    part = bump.divided(ticks)
    for _ in range(ticks):
        part.strike(loop.simulation)
        loop.tick()
    loop.run(_STOPPED_S)
