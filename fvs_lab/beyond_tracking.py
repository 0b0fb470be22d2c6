"""Targets that move: along a line, and round a circle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fvs_controller_node.reasons import State
from fvs_lab.beyond_contestants import variant
from fvs_lab.trials import (
    HOME_RAD,
    PRELUDE_S,
    Case,
    Conditions,
    make_cases,
    simulation_of,
)

LINE, CIRCLE = "line", "circle"
RADIUS_M = 0.08
SPEEDS_M_S = (0.02, 0.05, 0.1, 0.2, 0.3)
#: Least and largest distance of a line's ends, m.
_LINE_M = (0.45, 0.6)
#: Longest run, and its beginning, which does not count, by kind, s.
LONGEST_S = {LINE: 3.0, CIRCLE: 4.0}
START_S = {LINE: 0.8, CIRCLE: 1.5}
#: The target is told as often as a camera would, Hz.
RATE_HZ = 30.0


@dataclass(frozen=True)
class Path:
    """Where a target goes, camera frame.

    Parameters
    ----------
    kind : str
        ``line`` or ``circle``.
    start_rad : tuple of float
        Joints whose ball is where it begins, rad.
    origin_m, first, second : tuple of 3 float
        The beginning, m; unit vectors: a line goes along the first, a circle is in the plane of
        both and begins along the second.
    length_m : float
        After which a line ends, m.
    seed : int
        Of the noise.
    """

    kind: str
    start_rad: tuple[float, ...]
    origin_m: tuple[float, ...]
    first: tuple[float, ...]
    second: tuple[float, ...]
    length_m: float
    seed: int

    def at(self, way_m: float) -> np.ndarray:
        """The target after a length of its way, m, shape (3,)."""
        origin, first = np.array(self.origin_m), np.array(self.first)
        if self.kind == LINE:
            return origin + way_m * first
        angle = way_m / RADIUS_M
        turned = (np.cos(angle) - 1.0) * first + np.sin(angle) * np.array(self.second)
        return origin + RADIUS_M * turned

    def duration_s(self, speed_m_s: float) -> float:
        """How long it is followed, s."""
        return min(LONGEST_S[self.kind], self.length_m / speed_m_s)


@dataclass(frozen=True)
class Pursuit:
    """A target to be followed.

    Parameters
    ----------
    name : str
        The contestant.
    path : Path
        The target's.
    speed_m_s : float
        Of the target, m/s.
    feed_forward : bool
        Whether the controller goes along with it.
    conditions : Conditions
        The world.
    """

    name: str
    path: Path
    speed_m_s: float
    feed_forward: bool
    conditions: Conditions


def draw_paths(count: int, seed: int) -> list[Path]:
    """Draw lines between places in box M, and as many circles in any plane about home."""
    rng = np.random.default_rng(seed)
    simulation = simulation_of(Conditions())

    def ball_m(joints_rad: Sequence[float]) -> np.ndarray:
        simulation.reset(joints_rad)
        return simulation.true_ball_position()

    home = tuple(HOME_RAD.tolist())
    paths = []
    for case in make_cases("L", count, seed, *_LINE_M):
        start_m, goal_m = ball_m(case.start_rad), ball_m(case.goal_rad)
        length_m = float(np.linalg.norm(goal_m - start_m))
        along = tuple(((goal_m - start_m) / length_m).tolist())
        paths.append(
            Path(LINE, case.start_rad, tuple(start_m.tolist()), along, along, length_m, case.seed)
        )
    for line in paths[:count]:
        plane = np.linalg.qr(rng.normal(size=(3, 2)))[0]
        first, second = (tuple(vector.tolist()) for vector in plane.T)
        origin = tuple(ball_m(home).tolist())
        paths.append(Path(CIRCLE, home, origin, first, second, np.inf, line.seed))
    return paths


def run_pursuit(pursuit: Pursuit) -> dict[str, Any]:
    """Follow one target; the same to the bit in whatever process.

    Returns
    -------
    dict
        A row; ``rms_m`` is the distance of the true ball from the target after the start, m,
        infinite for an arm that the supervisor held.
    """
    path = pursuit.path
    simulation = simulation_of(pursuit.conditions)
    simulation.reset(path.start_rad, path.seed)
    one = variant(pursuit.name, target_feed_forward=pursuit.feed_forward)
    case = Case("", path.start_rad, path.start_rad, path.seed)
    loop = one.trial(case, pursuit.conditions).loop(simulation)
    loop.run(PRELUDE_S)
    squares_m2, next_s, held = [], 0.0, False
    for tick in range(round(path.duration_s(pursuit.speed_m_s) / loop.period_s)):
        now_s = tick * loop.period_s
        if now_s >= next_s:
            loop.set_target(path.at(pursuit.speed_m_s * now_s))
            next_s += 1.0 / RATE_HZ
        held = loop.tick().state is not State.SERVOING
        if now_s >= START_S[path.kind]:
            target_m = path.at(pursuit.speed_m_s * (now_s + loop.period_s))
            error_m = simulation.true_ball_position() - target_m
            squares_m2.append(float(error_m @ error_m))
    return {
        "part": "tracking",
        "scheme": pursuit.name,
        "path": path.kind,
        "seed": path.seed,
        "speed_m_s": pursuit.speed_m_s,
        "feed_forward": pursuit.feed_forward,
        "rms_m": float("inf") if held else float(np.sqrt(np.mean(squares_m2))),
    }
