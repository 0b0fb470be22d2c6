"""One servoing run and its judgement: the atom of every comparison."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from fvs_lab.disturbances import WHITE, Bump, StableNoise, carried_camera
from fvs_lab.outcome import JACOBIAN_EVERY, Outcome, RunLog, settling_columns
from fvs_ros.joints import HOME_JOINTS_RAD, TRAINING_BOX_RAD
from fvs_sim_node.simulation import LIVE, SimConfig, Simulation
from fvs_tools.closed_loop import MODEL, ClosedLoop, make_estimator
from fvs_tools.schemes import Scheme

#: Middle and half widths of the box that starts and goals are drawn from, rad.
HOME_RAD = np.array(HOME_JOINTS_RAD)
BOX_RAD = np.array(TRAINING_BOX_RAD)

#: Time at rest before the target is given, for the controller's inputs to be fresh, s.
PRELUDE_S = 0.4


@dataclass(frozen=True)
class Conditions:
    """What world a run takes place in; the same for all who are compared.

    Parameters
    ----------
    rendered : bool
        Whether ball positions come from rendered images.
    position_noise_m : float
        Further noise on each coordinate, m.
    noise_exponent : float
        That of :class:`StableNoise`; 2 for white noise.
    depth_noise : float
        Factor on the depth camera's own noise (rendered only).
    image_rate_hz : float
        Images a second.
    latency_s : float
        From exposure to the ball position's release, s.
    dropout : float
        Share of the images that are lost.
    focal_error, depth_error : float
        Errors of the camera's calibration: by what share the focal length that the detection is
        told, and the depths, are too large.
    encoder_noise_rad : float
        White noise on each joint angle that is told, rad.
    dead_time_s : float
        From a command to the drives' first answer, s.
    joint_lag_s : float
        Further lag of the drives, s.
    lag_s, acceleration_limit_rad_s2 : float
        Lag and largest acceleration of the drives themselves, s and rad/s^2.
    drive_gain : float
        How fast the drives go over how fast they are told to.
    physics_rate_hz : float
        Steps of the physics a second; fewer make a search faster.
    camera_turn_deg : tuple of 3 float
        Rotation vector, camera frame, degrees, by which the camera has been carried round the
        scene since the networks were trained; it still looks at the scene.
    """

    rendered: bool = True
    position_noise_m: float = 0.001
    noise_exponent: float = WHITE
    depth_noise: float = 1.0
    image_rate_hz: float = 30.0
    latency_s: float = 0.04
    dropout: float = 0.0
    focal_error: float = 0.0
    depth_error: float = 0.0
    encoder_noise_rad: float = 0.0
    dead_time_s: float = SimConfig.dead_time_s
    joint_lag_s: float = 0.0
    lag_s: float = SimConfig.lag_s
    acceleration_limit_rad_s2: float = SimConfig.acceleration_limit_rad_s2
    drive_gain: float = 1.0
    physics_rate_hz: float = 500.0
    camera_turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def sim_config(self) -> SimConfig:
        """The simulation of these conditions."""
        return SimConfig(
            **{name: getattr(self, name) for name in (*LIVE, *_BUILT)},
            camera_pose=carried_camera(np.radians(self.camera_turn_deg)),
        )


#: Fields of the conditions that a simulation is built with; the others are set on it.
_BUILT = ("rendered", "physics_rate_hz", "lag_s", "acceleration_limit_rad_s2")


@dataclass(frozen=True)
class Case:
    """A start, a goal and the noise between them.

    Parameters
    ----------
    name : str
        For tables.
    start_rad, goal_rad : tuple of float
        Joints at the start, and joints whose ball position is the target, rad.
    seed : int
        Of the run's noise.
    """

    name: str
    start_rad: tuple[float, ...]
    goal_rad: tuple[float, ...]
    seed: int


@dataclass(frozen=True)
class Trial:
    """A case, who is to master it, and under what conditions.

    Parameters
    ----------
    case : Case
        Start, goal and seed.
    method, law : str
        Estimator and control law, by their registries' names.
    estimator_values, controller_values : mapping
        The nodes' parameters, where they differ from the defaults.
    conditions : Conditions
        The world.
    duration_s : float
        Time from the target on, s.
    stop_after_s : float, optional
        End when the error has been below 5 mm for this time, s; for searches.
    record : bool
        Whether to keep the time series.
    model : str
        Trained model that the estimator begins with: a file of the ``config`` folder, or a path.
    bump : Bump, optional
        A blow to the camera.
    """

    case: Case
    method: str
    law: str
    estimator_values: Mapping[str, Any] = field(default_factory=dict)
    controller_values: Mapping[str, Any] = field(default_factory=dict)
    conditions: Conditions = field(default_factory=Conditions)
    duration_s: float = 4.0
    stop_after_s: float | None = None
    record: bool = False
    model: str = MODEL
    bump: Bump | None = None

    def loop(self, simulation: Simulation) -> ClosedLoop:
        """The whole loop in a simulation that has been reset."""
        estimator = make_estimator(self.method, simulation, self.estimator_values, self.model)
        return ClosedLoop(simulation, estimator, {"law": self.law, **self.controller_values})


@dataclass(frozen=True)
class Variant:
    """One of those that an experiment compares.

    Parameters
    ----------
    labels : mapping
        Columns of the tidy table that tell it from the others.
    method, law : str
        Estimator and control law, by their registries' names.
    estimator_values, controller_values : mapping
        The nodes' parameters, where they differ from the defaults.
    conditions : mapping
        Fields of the conditions that differ from the experiment's.
    """

    labels: Mapping[str, Any]
    method: str = "rbf"
    law: str = "ftsm"
    estimator_values: Mapping[str, Any] = field(default_factory=dict)
    controller_values: Mapping[str, Any] = field(default_factory=dict)
    conditions: Mapping[str, Any] = field(default_factory=dict)

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

    def trial(self, case: Case, conditions: Conditions, **fields: Any) -> Trial:
        """A trial of it; fields are further ones of the trial."""
        return Trial(
            case,
            self.method,
            self.law,
            self.estimator_values,
            self.controller_values,
            replace(conditions, **self.conditions),
            **fields,
        )


def simulation_of(conditions: Conditions) -> Simulation:
    """The process's simulation, put under these conditions; to be reset before use."""
    simulation = _build(Conditions(**{name: getattr(conditions, name) for name in _BUILT}))
    config = conditions.sim_config()
    for name in LIVE:
        setattr(simulation, name, getattr(config, name))
    assert config.camera_pose is not None
    simulation.camera = config.camera_pose
    simulation.speed_scaling = conditions.drive_gain
    simulation.position_noise = (
        None
        if conditions.noise_exponent == WHITE
        else StableNoise(conditions.position_noise_m, conditions.noise_exponent)
    )
    return simulation


@lru_cache(maxsize=4)
def _build(conditions: Conditions) -> Simulation:
    return Simulation(conditions.sim_config())


def make_cases(
    label: str, count: int, seed: int, low_m: float = 0.2, high_m: float = 0.5
) -> list[Case]:
    """Draw starts and goals whose balls are visible and some way apart.

    Parameters
    ----------
    label : str
        Beginning of their names.
    count : int
        How many.
    seed : int
        Of the draw, and of the cases' own seeds.
    low_m, high_m : float
        Least and largest distance of start and target, m.
    """
    rng = np.random.default_rng(seed)
    simulation = simulation_of(Conditions())
    cases: list[Case] = []
    while len(cases) < count:
        pair = HOME_RAD + rng.uniform(-1.0, 1.0, (2, HOME_RAD.size)) * BOX_RAD
        balls = []
        for joints in pair:
            simulation.reset(joints)
            seen = simulation.look()
            if seen.detection is None or seen.detection.visible_fraction < 0.9:
                break
            balls.append(seen.true_position_m)
        else:
            if low_m <= float(np.linalg.norm(balls[1] - balls[0])) <= high_m:
                start, goal = (tuple(float(angle) for angle in joints) for joints in pair)
                number = len(cases) + 1
                cases.append(Case(f"{label}{number}", start, goal, 1000 * seed + number))
    return cases


def run_trial(trial: Trial) -> Outcome:
    """Run one trial.

    Returns
    -------
    Outcome
        The same to the bit for the same trial, in whatever process.
    """
    return drive(trial, simulation_of(trial.conditions))


def drive(trial: Trial, simulation: Simulation) -> Outcome:
    """Run one trial in a simulation that has been set up.

    Parameters
    ----------
    trial : Trial
        What to run; its conditions are those that the simulation is in.
    simulation : Simulation
        It is reset; disturbances that were set stay.
    """
    simulation.reset(trial.case.goal_rad)
    goal_m = simulation.world.ball_position()
    simulation.reset(trial.case.start_rad, trial.case.seed)
    one = trial.loop(simulation)
    one.run(PRELUDE_S)
    target_m = _tell_target(one, goal_m)
    log, bump = RunLog(simulation.time_s), trial.bump
    bump_tick = None if bump is None else round(bump.time_s / one.period_s)
    for tick in range(round(trial.duration_s / one.period_s)):
        if bump is not None and tick == bump_tick:
            bump.strike(simulation)
            target_m = _tell_target(one, goal_m)
        command = one.tick()
        log.add(simulation.time_s, simulation.true_ball_position(), target_m, command)
        if tick % JACOBIAN_EVERY == 0:
            log.add_jacobian_error(jacobian_error(one))
        if trial.stop_after_s is not None and log.rested_s() >= trial.stop_after_s:
            break
    return log.outcome(trial.record)


def _tell_target(one: ClosedLoop, goal_m: np.ndarray) -> np.ndarray:
    """Tell a target as its camera sees it; where it truly is, camera frame, m."""
    target_m = one.simulation.camera.to_camera(goal_m)
    one.set_target(one.simulation.as_seen(target_m))
    return target_m


def settling_run(one: ClosedLoop, target_m: np.ndarray, duration_s: float) -> dict[str, float]:
    """Give a target, camera frame, m, let time pass, and return the settling times as columns."""
    one.set_target(target_m)
    errors_m = []
    for _ in range(round(duration_s / one.period_s)):
        one.tick()
        errors_m.append(np.linalg.norm(one.simulation.true_ball_position() - target_m))
    return settling_columns(one.period_s * np.arange(1, len(errors_m) + 1), np.array(errors_m))


def jacobian_error(one: ClosedLoop) -> float:
    """Relative Frobenius error of the Jacobian that the controller uses now."""
    true = one.simulation.true_jacobian(one.simulation.joints_rad)
    used = one.loop.jacobian
    return float("nan") if used is None else float(relative_errors(used, true))


def relative_errors(jacobian: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Relative Frobenius errors of one or many Jacobians, shape (..., m, n)."""
    wrong = np.linalg.norm(jacobian - true, axis=(-2, -1))
    return np.asarray(wrong / np.linalg.norm(true, axis=(-2, -1)))
