"""Random worlds: start, target, camera, noise, delay and loss, a pure function of a number."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from math import hypot

import numpy as np

from fvs_ros.apps.experiments.trials import Bump, Case, Conditions, carried_camera, make_cases
from fvs_sim_node.rendering import CameraPose
from fvs_sim_node.simulation import Simulation

#: Least and largest distance of start and target, m.
DISTANCE_M = (0.1, 0.5)
#: Exponent of noise without heavy tails.
WHITE = 2.0
#: No error of a coordinate is larger than this, m: the detection knows the size of the ball.
_LARGEST_ERROR_M = 0.1
#: Share of the ball that must be seen at start and target, whatever happens to the camera.
_VISIBLE = 0.9


@dataclass(frozen=True)
class Kind:
    """A kind of worlds.

    Parameters
    ----------
    name : str
        Of the experiment.
    seed : int
        Of all its worlds.
    ranges : mapping of str to (float, float)
        Ranges that everything but start and target is drawn from, evenly.
    bumped_share, heavy_share : float
        Shares of the worlds in which the camera is bumped, and in which the noise has heavy tails.
    """

    name: str
    seed: int
    ranges: Mapping[str, tuple[float, float]]
    bumped_share: float = 0.0
    heavy_share: float = 0.0


#: Everything that may go wrong does so at once.
HARSH = Kind(
    "robustness",
    304,
    {
        "camera_turn_deg": (0.0, 30.0),
        "bump_turn_deg": (0.0, 10.0),
        "bump_shift_m": (0.0, 0.1),
        "bump_time_s": (0.3, 2.0),
        "noise_m": (0.0002, 0.002),
        "noise_exponent": (1.5, 1.8),
        "latency_s": (0.0, 0.1),
        "image_loss": (0.0, 0.2),
        "joint_lag_s": (0.0, 0.04),
    },
    bumped_share=1 / 3,
    heavy_share=1 / 2,
)
#: What a well-kept laboratory has: a usual sensor, and a camera that was moved since the training.
EVERYDAY = Kind(
    "everyday",
    305,
    {
        **HARSH.ranges,
        "noise_m": (0.001, 0.001),
        "latency_s": (0.05, 0.05),
        "image_loss": (0.1, 0.1),
        "joint_lag_s": (0.0, 0.0),
    },
)

KINDS = {kind.name: kind for kind in (EVERYDAY, HARSH)}


@dataclass(frozen=True)
class StableNoise:
    """Symmetric alpha-stable errors of a ball position, by Chambers, Mallows and Stuck.

    Parameters
    ----------
    scale_m : float
        Standard deviation at exponent 2, m; with less, the bulk is as wide and the tails heavy.
    exponent : float
        Above 1, up to 2 (white, normally distributed).
    """

    scale_m: float
    exponent: float

    def __call__(self, rng: np.random.Generator) -> np.ndarray:
        """Draw the errors of the three coordinates, cut off where no camera errs so far, m."""
        alpha = self.exponent
        angle = rng.uniform(-0.5 * np.pi, 0.5 * np.pi, 3)
        waiting = rng.exponential(size=3)
        spread = (np.cos((1.0 - alpha) * angle) / waiting) ** ((1.0 - alpha) / alpha)
        draw = np.sin(alpha * angle) / np.cos(angle) ** (1.0 / alpha) * spread
        error_m = self.scale_m / np.sqrt(2.0) * draw
        return np.clip(error_m, -_LARGEST_ERROR_M, _LARGEST_ERROR_M)


@dataclass(frozen=True)
class World:
    """What all contestants meet in one trial.

    Parameters
    ----------
    number : int
        Of the trial, from 1.
    case : Case
        Start, goal and the seed of the noise.
    distance_m : float
        From start to target, m.
    camera_turn_deg : tuple of 3 float
        How the camera has been carried round the scene since the networks were trained; rotation
        vector in its own frame, degrees.
    bump : Bump or None
        A blow to the camera in mid-run.
    noise_m, noise_exponent : float
        Of :class:`StableNoise`.
    latency_s : float
        From exposure to the ball position's release, s.
    image_loss : float
        Probability that an image is lost.
    joint_lag_s : float
        Further lag of the drives, s.
    """

    number: int
    case: Case
    distance_m: float
    camera_turn_deg: tuple[float, float, float]
    bump: Bump | None
    noise_m: float
    noise_exponent: float
    latency_s: float
    image_loss: float
    joint_lag_s: float

    @property
    def turn_deg(self) -> float:
        """How far the camera has been carried round, degrees."""
        return hypot(*self.camera_turn_deg)

    @property
    def bump_deg(self) -> float:
        """How far a bump turns the camera, degrees; 0 without one."""
        return 0.0 if self.bump is None else hypot(*self.bump.rotation_deg)

    def simulation(self, rendered: bool) -> Simulation:
        """The process's simulation, set up as this world; to be reset before use."""
        simulation = _simulation(rendered)
        simulation.camera = carried_camera(np.radians(self.camera_turn_deg))
        simulation.position_noise = StableNoise(self.noise_m, self.noise_exponent)
        simulation.latency_s = self.latency_s
        simulation.dropout = self.image_loss
        simulation.joint_lag_s = self.joint_lag_s
        return simulation

    def words(self) -> str:
        """Say what it is, in a sentence."""
        tails = (
            "white"
            if self.noise_exponent == WHITE
            else f"heavy tails, exponent {self.noise_exponent:.2f}"
        )
        bump = self.bump
        blow = (
            ""
            if bump is None
            else f", camera bumped by {self.bump_deg:.1f}° and "
            f"{1e3 * hypot(*bump.translation_m):.0f} mm after {bump.time_s:.1f} s"
        )
        return (
            f"{1e3 * self.distance_m:.0f} mm to go, camera carried round by {self.turn_deg:.1f}°"
            f"{blow}, {1e3 * self.noise_m:.1f} mm noise ({tails}), {1e3 * self.latency_s:.0f} ms "
            f"latency, {100 * self.image_loss:.0f} % of images lost, "
            f"{1e3 * self.joint_lag_s:.0f} ms joint lag; noise seed {self.case.seed}"
        )


def draw_world(kind: Kind, number: int) -> World:
    """Draw the world of a trial.

    How much of everything there is comes from the ranges alone; start, target and the directions
    are drawn until the ball is seen at both ends, before and after whatever happens to the camera.

    Parameters
    ----------
    kind : Kind
        What there is, and the seed of the whole experiment.
    number : int
        Of the trial.
    """
    rng = np.random.default_rng([kind.seed, number])
    amount = {name: float(rng.uniform(*range_)) for name, range_ in kind.ranges.items()}
    bumped, heavy = rng.random() < kind.bumped_share, rng.random() < kind.heavy_share
    while True:
        case = make_cases(f"R{number}-", 1, int(rng.integers(2**31)), *DISTANCE_M)[0]
        turn_deg = _direction(rng, amount["camera_turn_deg"])
        bump = Bump(
            amount["bump_time_s"],
            _direction(rng, amount["bump_turn_deg"]),
            _direction(rng, amount["bump_shift_m"]),
        )
        distance_m = _visible_distance_m(case, turn_deg, bump if bumped else None)
        if distance_m is not None:
            break
    return World(
        number,
        case,
        distance_m,
        turn_deg,
        bump if bumped else None,
        amount["noise_m"],
        amount["noise_exponent"] if heavy else WHITE,
        amount["latency_s"],
        amount["image_loss"],
        amount["joint_lag_s"],
    )


@lru_cache(maxsize=2)
def _simulation(rendered: bool) -> Simulation:
    return Simulation(Conditions(rendered=rendered).sim_config())


def _direction(rng: np.random.Generator, length: float) -> tuple[float, float, float]:
    """Draw a vector of this length, any direction as likely as another."""
    vector = rng.normal(size=3)
    x, y, z = (length * vector / np.linalg.norm(vector)).tolist()
    return (x, y, z)


def _visible_distance_m(
    case: Case, turn_deg: tuple[float, float, float], bump: Bump | None
) -> float | None:
    """Distance from start to target, m; None if the ball cannot be seen at either of them."""
    simulation = _simulation(rendered=True)
    simulation.camera = carried_camera(np.radians(turn_deg))
    cameras = [simulation.camera]
    if bump is not None:
        bump.strike(simulation)
        cameras.append(simulation.camera)
    ends = []
    for joints in (case.start_rad, case.goal_rad):
        simulation.reset(np.array(joints))
        if not all(_sees(simulation, camera) for camera in cameras):
            return None
        ends.append(simulation.world.ball_position())
    return float(np.linalg.norm(ends[1] - ends[0]))


def _sees(simulation: Simulation, camera: CameraPose) -> bool:
    simulation.camera = camera
    detection = simulation.look().detection
    return detection is not None and detection.visible_fraction >= _VISIBLE
