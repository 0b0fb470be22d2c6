"""One servoing run and the world it takes place in: the atom of every comparison."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from itertools import islice, product
from typing import Any

import numpy as np

from fvs_controller_node.supervisor import Command
from fvs_detector_node.tags import Tag
from fvs_estimator_node.base import Estimator
from fvs_lab.outcome import BOUNDS_M, JACOBIAN_EVERY, Outcome, outcome_of
from fvs_ros.kinds.ball import Ball
from fvs_ros.rotations import rotation_from_vector
from fvs_ros.track import Track
from fvs_ros.vectors import length
from fvs_sim_node.camera import CAMERAS, CameraPose
from fvs_sim_node.robot import HOME_JOINTS_RAD, TRAINING_BOX_RAD
from fvs_sim_node.simulation import SimConfig, Simulation
from fvs_tools.closed_loop import ClosedLoop, make_estimator
from fvs_tools.schemes import Scheme

#: Middle and half widths of the box that starts and goals are drawn from, rad.
HOME_RAD = np.array(HOME_JOINTS_RAD)
BOX_RAD = np.array(TRAINING_BOX_RAD)
#: Time at rest before the target is given, for the controller's inputs to be fresh, s.
PRELUDE_S = 0.4
#: A target that moves is given as often as a camera would, Hz.
TARGET_RATE_HZ = 30.0
#: Exponent of noise without heavy tails.
WHITE = 2.0
#: Largest error of a coordinate, m: the detection knows the size of the ball.
_LARGEST_ERROR_M = 0.1
#: What the camera looks at: about where the ball is at home, world frame, m.
_SCENE_M = np.array([0.47, 0.1, 0.33])

Vector = tuple[float, float, float]
#: Joints, rad.
Joints = tuple[float, ...]


def along(direction: np.ndarray, length: float) -> Vector:
    """A vector of this length."""
    x, y, z = (length * direction / np.linalg.norm(direction)).tolist()
    return (x, y, z)


# ---- the world ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Conditions:
    """The world of a run, the same for all variants in a comparison."""

    #: What the arm carries: a ball, or a tag (pose).
    feature: str = Ball.name
    #: Whether it is seen in rendered images.
    rendered: bool = True
    #: Further noise on each coordinate, m, and that of :class:`StableNoise`; 2 for white noise.
    position_noise_m: float = 0.001
    noise_exponent: float = WHITE
    #: Factor on the depth camera's own noise (rendered only).
    depth_noise: float = 1.0
    image_rate_hz: float = 30.0
    #: From exposure to the ball position's release, s.
    latency_s: float = 0.04
    #: Share of the images that are lost.
    dropout: float = 0.0
    #: Relative error, positive for too large, of the reported focal length and of the depths.
    focal_error: float = 0.0
    depth_error: float = 0.0
    #: White noise on each reported joint angle, rad.
    encoder_noise_rad: float = 0.0
    #: From a command to the drives' first answer, and further lag of the drives, s.
    dead_time_s: float = SimConfig.dead_time_s
    joint_lag_s: float = 0.0
    #: Speed of the drives over the commanded one.
    drive_gain: float = 1.0
    #: Steps of the physics a second; fewer make a search faster.
    physics_rate_hz: float = 500.0
    #: Rotation vector, camera frame, degrees, by which the camera has been carried round the scene
    #: since the networks were trained; it still looks at the scene.
    camera_turn_deg: Vector = (0.0, 0.0, 0.0)
    #: From the middle of the scene, m; 0 for that of the front camera.
    camera_distance_m: float = 0.0
    #: The tag, or the body of tags, where the feature is a pose.
    tag: Tag = field(default_factory=Tag)

    def sim_config(self) -> SimConfig:
        """The simulation of these conditions."""
        alike = {one.name for one in fields(self)} & {one.name for one in fields(SimConfig)}
        return SimConfig(
            **{name: getattr(self, name) for name in alike},
            speed_scaling_percent=100.0 * self.drive_gain,
            camera_pose=_carried_camera(np.radians(self.camera_turn_deg), self.camera_distance_m),
        )


def _carried_camera(turn_rad: np.ndarray, distance_m: float) -> CameraPose:
    """The front camera, carried round the scene by a rotation vector in its own frame, rad.

    The Jacobian turns with it. The ball stays in view; a rotation by 30 degrees on the spot would
    lose it. With a distance it is also carried so far from the scene's middle, m.
    """
    camera = CAMERAS["front"]
    away_m = camera.position_m - _SCENE_M
    if distance_m:
        away_m *= distance_m / np.linalg.norm(away_m)
    local = rotation_from_vector(turn_rad)
    turn = camera.rotation @ local @ camera.rotation.T
    return CameraPose(_SCENE_M + turn @ away_m, camera.rotation @ local)


def simulation_of(conditions: Conditions) -> Simulation:
    """The process's simulation, put under these conditions; to be reset before use."""
    simulation = _build(conditions.physics_rate_hz, conditions.feature, conditions.tag)
    simulation.configure(conditions.sim_config())
    simulation.position_noise = (
        None
        if conditions.noise_exponent == WHITE
        else StableNoise(conditions.position_noise_m, conditions.noise_exponent)
    )
    return simulation


@lru_cache(maxsize=4)
def _build(physics_rate_hz: float, feature: str, tag: Tag) -> Simulation:
    return Simulation(Conditions(feature, physics_rate_hz=physics_rate_hz, tag=tag).sim_config())


@dataclass(frozen=True)
class StableNoise:
    """Symmetric alpha-stable errors of a ball position."""

    #: Standard deviation at exponent 2, m; with less, the bulk is as wide and the tails heavy.
    scale_m: float
    #: Above 1, up to 2 (white, normally distributed).
    exponent: float

    def __call__(self, rng: np.random.Generator) -> np.ndarray:
        """Draw the errors of the three coordinates, m, cut off at the largest plausible error."""
        from scipy.stats import levy_stable

        scale_m = self.scale_m / np.sqrt(2.0)
        error_m = levy_stable.rvs(self.exponent, 0.0, scale=scale_m, size=3, random_state=rng)
        return np.clip(error_m, -_LARGEST_ERROR_M, _LARGEST_ERROR_M)


@dataclass(frozen=True)
class Bump:
    """A blow to the camera in mid-run, after which the target is given anew in the new view."""

    #: After the target was given, s.
    time_s: float
    #: Rotation vector about the camera's own centre, camera frame, degrees.
    rotation_deg: Vector
    #: In the world frame, m.
    translation_m: Vector

    def strike(self, simulation: Simulation, parts: int = 1) -> None:
        """Move the camera, or by one of several equal parts."""
        turned = simulation.camera.turned(np.radians(np.array(self.rotation_deg) / parts))
        simulation.camera = turned.moved(np.array(self.translation_m) / parts)


# ---- what is run ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """A start, and a goal whose ball position is the target, as joints, rad; seed of the noise."""

    name: str
    start_rad: Joints
    goal_rad: Joints
    seed: int


class LastImage(Track):
    """Uses what the last image measured as its present value."""

    def now(self) -> np.ndarray | None:
        """Find the measurement of the last image, (m,)."""
        return None if super().now() is None or self.newest is None else self.newest.z


@dataclass(frozen=True)
class Variant:
    """One candidate in the comparison of an experiment."""

    #: Columns of the tidy table that tell it from the others.
    labels: Mapping[str, Any] = field(default_factory=dict)
    #: Estimator and control law, by their registries' names.
    method: str = "rbf"
    law: str = "ftsm"
    #: The nodes' parameters, where they differ from the defaults.
    estimator_values: Mapping[str, Any] = field(default_factory=dict)
    controller_values: Mapping[str, Any] = field(default_factory=dict)
    #: Whether the ball is predicted from its exposure to now; else the last image counts.
    predicts: bool = True
    #: Fields of the conditions that differ from the experiment's.
    conditions: Mapping[str, Any] = field(default_factory=dict)
    #: Makes an estimator that no registry has.
    estimator: Callable[[Simulation, Case], Estimator] | None = None

    @classmethod
    def of(cls, scheme: Scheme, **controller_values: Any) -> Variant:
        """A scheme, labelled by its name, with further parameters of the controller."""
        return cls(
            {"scheme": scheme.name},
            scheme.method,
            scheme.law,
            scheme.estimator_values,
            {**scheme.controller_values, **controller_values},
        )

    def labelled(self, **labels: Any) -> Variant:
        """The same with further labels."""
        return replace(self, labels={**self.labels, **labels})

    def trial(self, case: Case, conditions: Conditions, **fields: Any) -> Trial:
        """A trial of it; fields are further ones of the trial."""
        return Trial(self, case, replace(conditions, **self.conditions), **fields)


@dataclass(frozen=True)
class Trial:
    """A case, the variant to run in it, and the conditions."""

    variant: Variant
    case: Case
    conditions: Conditions = field(default_factory=Conditions)
    #: Time from the target on, s.
    duration_s: float = 4.0
    #: End when the error has been below 5 mm for this time, s; for searches.
    stop_after_s: float | None = None
    #: Whether to keep the time series.
    record: bool = False
    #: A blow to the camera.
    bump: Bump | None = None
    #: What happens before the target is given.
    before: Callable[[ClosedLoop], None] | None = None
    #: For a moving target: its position, camera frame, m, at a time, s.
    path: Callable[[float], np.ndarray] | None = None

    @property
    def labels(self) -> dict[str, Any]:
        """Columns of the tidy table that tell it from the others."""
        return {**self.variant.labels, "case": self.case.name}

    def loop(self, simulation: Simulation) -> ClosedLoop:
        """The whole loop in a simulation that has been reset."""
        who = self.variant
        if who.estimator is None:
            estimator = make_estimator(who.method, simulation, who.estimator_values)
        else:
            estimator = who.estimator(simulation, self.case)
        one = ClosedLoop(simulation, estimator, {"law": who.law, **who.controller_values})
        if not who.predicts:
            one.loop.track = LastImage(one.kind)
        return one


def sees(simulation: Simulation) -> bool:
    """Whether the camera sees enough of the ball, or the tag three times."""
    looks = (simulation.look().detection for _ in range(3))
    return all(seen is not None and seen.visible_fraction >= 0.9 for seen in looks)


def photo(simulation: Simulation) -> np.ndarray:
    """What the camera sees now, uint8, (H, W, 3)."""
    simulation.full_frames = True
    frame = simulation.look().frame
    simulation.full_frames = False
    assert frame is not None
    return frame.rgb


def sees_all(
    conditions: Conditions, places: Iterable[Joints | np.ndarray], bump: Bump | None = None
) -> bool:
    """Whether the camera sees it at all of these joints, rad, (n,) each, also after a bump."""
    simulation = simulation_of(conditions)
    cameras = [simulation.camera]
    if bump is not None:
        bump.strike(simulation)
        cameras.append(simulation.camera)
    for camera, joints in product(cameras, places):
        simulation.camera = camera
        simulation.reset(joints)
        if not sees(simulation):
            return False
    return True


def make_cases(
    label: str,
    count: int,
    seed: int,
    low_m: float = 0.2,
    high_m: float = 0.5,
    conditions: Conditions | None = None,
) -> list[Case]:
    """Draw starts and goals whose balls (or tags) are visible and this far apart, m.

    The label begins their names; the seed is that of the draw and of the cases' own seeds.
    """
    rng = np.random.default_rng(seed)

    def draw() -> np.ndarray:
        return HOME_RAD + rng.uniform(-1.0, 1.0, (2, HOME_RAD.size)) * BOX_RAD

    pairs = apart(simulation_of(conditions or Conditions()), draw, low_m, high_m)
    numbered = enumerate(islice(pairs, count), start=1)
    return [Case(f"{label}{number}", *pair, 1000 * seed + number) for number, pair in numbered]


def apart(
    simulation: Simulation, draw: Callable[[], np.ndarray], low_m: float, high_m: float = np.inf
) -> Iterator[tuple[Joints, Joints]]:
    """Draw pairs of joints, rad, (2, n), whose balls (or tags) are visible and this far apart."""
    while True:
        pair, balls = draw(), []
        for joints in pair:
            simulation.reset(joints)
            if not sees(simulation):
                break
            balls.append(simulation.true_ball_position())
        else:
            if low_m <= float(np.linalg.norm(balls[1] - balls[0])) <= high_m:
                start, goal = map(tuple, pair.tolist())
                yield start, goal


# ---- runs -----------------------------------------------------------------------------------


def run_trial(trial: Trial) -> Outcome:
    """Run one trial; the same to the bit in whatever process."""
    return drive(trial, simulation_of(trial.conditions))


def drive(trial: Trial, simulation: Simulation) -> Outcome:
    """Run one trial in a simulation that has been put under its conditions."""
    simulation.reset(trial.case.start_rad, trial.case.seed)
    one = trial.loop(simulation)
    simulation.reset(trial.case.goal_rad)
    goal_m = in_world(one)
    simulation.reset(trial.case.start_rad, trial.case.seed)
    one.run(PRELUDE_S)
    if trial.before is not None:
        trial.before(one)
    target_m = np.empty(0) if trial.path else give_target(one, goal_m)
    start_s, next_s = simulation.time_s, 0.0
    bump_tick = -1 if trial.bump is None else round(trial.bump.time_s / one.period_s)
    times_s: list[float] = []
    balls_m: list[np.ndarray] = []
    errors_m: list[float] = []
    commands: list[Command] = []
    jacobian_errors: list[float] = []
    below_since_s = np.inf
    for tick in range(round(trial.duration_s / one.period_s)):
        if trial.bump is not None and tick == bump_tick:
            trial.bump.strike(simulation)
            target_m = give_target(one, goal_m)
        if trial.path is not None:
            now_s = tick * one.period_s
            if now_s >= next_s:
                one.set_target(trial.path(now_s))
                next_s += 1.0 / TARGET_RATE_HZ
            target_m = trial.path(now_s + one.period_s)
        commands.append(one.tick())
        times_s.append(simulation.time_s - start_s)
        balls_m.append(one.true_feature)
        errors_m.append(length(one.kind.minus(balls_m[-1], target_m)))
        if tick % JACOBIAN_EVERY == 0:
            jacobian_errors.append(jacobian_error(one))
        near = errors_m[-1] < BOUNDS_M["5mm"]
        below_since_s = min(below_since_s, times_s[-1]) if near else np.inf
        if trial.stop_after_s is not None and times_s[-1] - below_since_s >= trial.stop_after_s:
            break
    series = np.array(times_s), np.array(balls_m), np.array(errors_m), target_m
    return outcome_of(*series, commands, np.array(jacobian_errors), trial.record)


def in_world(one: ClosedLoop) -> np.ndarray:
    """The feature where it is now, world frame, m, (m,)."""
    directions = one.true_feature[3:].reshape(-1, 3) @ one.simulation.camera.rotation.T
    return np.append(one.simulation.world.ball_position(), directions)


def give_target(one: ClosedLoop, goal_m: np.ndarray) -> np.ndarray:
    """Give a target, world frame, as the camera sees it; returns the true one, camera frame, m."""
    camera = one.simulation.camera
    place_m, directions = camera.to_camera(goal_m[:3]), goal_m[3:].reshape(-1, 3) @ camera.rotation
    one.set_target(np.append(one.simulation.as_seen(place_m), directions))
    return np.append(place_m, directions)


def jacobian_error(one: ClosedLoop) -> float:
    """Relative Frobenius error of the Jacobian that the controller uses now."""
    true = one.simulation.true_feature_jacobian(one.simulation.joints_rad, one.kind)
    used = one.loop.jacobian
    return float("nan") if used is None else float(relative_errors(used, true))


def relative_errors(jacobian: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Relative Frobenius errors of one or many Jacobians, shape (..., m, n)."""
    wrong = np.linalg.norm(jacobian - true, axis=(-2, -1))
    return np.asarray(wrong / np.linalg.norm(true, axis=(-2, -1)))
