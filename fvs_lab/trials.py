"""One servoing run and its judgement: the atom of every comparison."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from fvs_controller_node.reasons import State
from fvs_controller_node.supervisor import Command
from fvs_estimator_node.base import Estimator
from fvs_lab.lockstep import (
    MODEL,
    LockStep,
    load_chain,
    load_networks,
    make_estimator,
)
from fvs_lab.noise import WHITE, StableNoise
from fvs_ros.joints import HOME_JOINTS_RAD, TRAINING_BOX_RAD
from fvs_sim_node.rendering import CameraPose, camera_preset
from fvs_sim_node.simulation import LIVE, SimConfig, Simulation
from fvs_tools.score import jitter_rad_s, settling_time_s

#: Middle and half widths of the box that starts and goals are drawn from, rad.
HOME_RAD = np.array(HOME_JOINTS_RAD)
BOX_RAD = np.array(TRAINING_BOX_RAD)

#: Errors whose settling times are taken, m.
BOUNDS_M = {"5 mm": 0.005, "2 mm": 0.002, "1 mm": 0.001}

#: Time at rest before the target is given, for the controller's inputs to be fresh, s.
PRELUDE_S = 0.4
#: Every so many ticks the Jacobian in use is compared with the true one.
_JACOBIAN_EVERY = 5
#: The end of a run, over which rest is judged, s.
REST_S = 1.0
#: Cause of a failure: the ball came near, and left again.
NOT_STAYED = "reached 5 mm, but did not stay"


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
        That of :class:`~fvs_lab.noise.StableNoise`; 2 for white noise.
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
    start_rad, goal_rad : tuple of 6 float
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
        End when the error has been below 5 mm for so long, s; for searches.
    record : bool
        Whether to keep the time series.
    model : str
        Trained model that the estimator begins with: a file of the ``config`` folder, or a path.
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

    def estimator(self, simulation: Simulation) -> Estimator:
        """The estimator, with the model that it begins with."""
        return make_estimator(
            self.method,
            simulation,
            load_networks(self.model),
            self.estimator_values,
            load_chain(self.model),
        )


@dataclass(frozen=True)
class Bump:
    """A blow to the camera in mid-run.

    The target is given anew at once, where it is for the camera now; nothing else is told.

    Parameters
    ----------
    time_s : float
        After the target was given, s.
    rotation_deg : tuple of 3 float
        Rotation vector about the camera's own centre, camera frame, degrees.
    translation_m : tuple of 3 float
        In the world frame, m.
    """

    time_s: float
    rotation_deg: tuple[float, float, float]
    translation_m: tuple[float, float, float]

    def divided(self, parts: int) -> Bump:
        """Return that of which so many in a row are this one."""
        (a, b, c), (x, y, z) = self.rotation_deg, self.translation_m
        return replace(
            self,
            rotation_deg=(a / parts, b / parts, c / parts),
            translation_m=(x / parts, y / parts, z / parts),
        )

    def strike(self, simulation: Simulation) -> None:
        """Move the camera."""
        simulation.rotate_camera(np.radians(self.rotation_deg))
        simulation.move_camera(self.translation_m)


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

    def summary(self) -> dict[str, Any]:
        """All but the time series."""
        names = self.__dataclass_fields__.keys() - {"series"}
        return {name: getattr(self, name) for name in sorted(names)}


def seconds(value: float | None) -> float:
    """A settling time as a number: infinite for never."""
    return float("inf") if value is None else value


def carried_camera(turn_rad: np.ndarray) -> CameraPose:
    """The front camera, carried round the scene by a rotation vector in its own frame, rad.

    The Jacobian turns with it; the ball stays in view, which a mere turn by 30 degrees on the
    spot would not allow.
    """
    camera = camera_preset("front")
    local = cv2.Rodrigues(np.asarray(turn_rad, dtype=float).reshape(3, 1))[0]
    turn = camera.rotation @ local @ camera.rotation.T
    return CameraPose(_SCENE_M + turn @ (camera.position_m - _SCENE_M), camera.rotation @ local)


#: What the camera looks at: about where the ball is at home, world frame, m.
_SCENE_M = np.array([-0.47, -0.1, 0.33])


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
        pair = HOME_RAD + rng.uniform(-1.0, 1.0, (2, 6)) * BOX_RAD
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


def drive(trial: Trial, simulation: Simulation, bump: Bump | None = None) -> Outcome:
    """Run one trial in a simulation that has been set up.

    Parameters
    ----------
    trial : Trial
        What to run; its conditions are those that the simulation is in.
    simulation : Simulation
        It is reset; disturbances that were set stay.
    bump : Bump, optional
        A blow to the camera.
    """
    simulation.reset(trial.case.goal_rad)
    goal_m = simulation.world.ball_position()
    simulation.reset(trial.case.start_rad, trial.case.seed)
    one = LockStep(
        simulation, trial.estimator(simulation), {"law": trial.law, **trial.controller_values}
    )
    one.run(PRELUDE_S)
    target_m = _tell_target(one, goal_m)
    log = _Log(simulation.time_s)
    bump_tick = None if bump is None else round(bump.time_s / one.period_s)
    for tick in range(round(trial.duration_s / one.period_s)):
        if bump is not None and tick == bump_tick:
            bump.strike(simulation)
            target_m = _tell_target(one, goal_m)
        command = one.tick()
        log.add(simulation.time_s, simulation.true_ball_position(), target_m, command)
        if tick % _JACOBIAN_EVERY == 0:
            log.add_jacobian_error(jacobian_error(one))
        if trial.stop_after_s is not None and log.rested_s() >= trial.stop_after_s:
            break
    return log.outcome(trial.record)


def _tell_target(one: LockStep, goal_m: np.ndarray) -> np.ndarray:
    """Tell a target as its camera sees it; where it truly is, camera frame, m."""
    target_m = one.simulation.camera.to_camera(goal_m)
    one.set_target(one.simulation.as_seen(target_m))
    return target_m


def jacobian_error(one: LockStep) -> float:
    """Relative Frobenius error of the Jacobian that the controller uses now."""
    true = one.simulation.true_jacobian(one.simulation.joints_rad)
    used = one.loop.jacobian
    if used is None:
        return float("nan")
    return float(np.linalg.norm(used - true) / np.linalg.norm(true))


class _Log:
    """Collects a run and judges it."""

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
        self._jacobian_error.append(error)

    def add(self, now_s: float, ball_m: np.ndarray, target_m: np.ndarray, command: Command) -> None:
        self._time_s.append(now_s - self._start_s)
        self._ball_m.append(ball_m)
        self._target_m.append(target_m)
        self._command.append(command.velocity_rad_s)
        output = command.output
        self._exponent.append(np.full(3, np.nan) if output is None else output.exponent)
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
            jacobian_error=float(
                np.mean(np.array(self._jacobian_error)[moving[::_JACOBIAN_EVERY]])
            ),
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
