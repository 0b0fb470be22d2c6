"""One servoing run and the world it takes place in: the atom of every comparison."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import islice, product
from typing import Any, ClassVar, TypeVar

import numpy as np

from fvs_controller_node.reasons import State
from fvs_controller_node.supervisor import Command
from fvs_estimator_node.base import Estimator
from fvs_ros.rotations import rotation_from_vector, vector_from_rotation_rad
from fvs_ros.track import Track
from fvs_ros.vectors import length
from fvs_sim_node.camera import CAMERAS, RigidPose
from fvs_sim_node.config import SimConfig
from fvs_sim_node.robot import HOME_JOINTS_RAD, TRAINING_BOX_RAD
from fvs_sim_node.simulation import Simulation
from fvs_tools.closed_loop import ClosedLoop, make_estimator
from fvs_tools.schemes import SCHEMES, Scheme
from fvs_tools.score import FINAL_S, FINE_ERROR_M, SETTLED_ERROR_M, settling_time_s

#: Ticks between comparisons of the Jacobian in use with the true one.
JACOBIAN_EVERY = 5
#: Middle and half widths of the box that starts and goals are drawn from, rad.
HOME_RAD = np.array(HOME_JOINTS_RAD)
BOX_RAD = np.array(TRAINING_BOX_RAD)

C = TypeVar("C", bound=SimConfig)
Vector = tuple[float, float, float]
#: Joints, rad.
Joints = tuple[float, ...]


def vector(numbers: np.ndarray) -> Vector:
    """Three numbers as a configuration holds them."""
    x, y, z = numbers.tolist()
    return (x, y, z)


def along(direction: np.ndarray, length: float) -> Vector:
    """A vector of this length."""
    return vector(length * direction / np.linalg.norm(direction))


def placed(config: C, pose: RigidPose) -> C:
    """A configuration with the object there, world frame."""
    return replace(
        config,
        object_position_m=vector(pose.position_m),
        object_rotation_deg=vector(np.degrees(vector_from_rotation_rad(pose.rotation))),
    )


# ---- the world ------------------------------------------------------------------------------


def stable_noise_m(
    scale_m: float, exponent: float, rng: np.random.Generator, size: int | tuple[int, ...] = 3
) -> np.ndarray:
    """Symmetric alpha-stable errors, such as of a ball position, m, (3,).

    With an exponent from above 1 to 2 (white) and, for 2, this standard deviation, m; with less,
    the bulk is as wide and the tails heavy.
    """
    from scipy.stats import levy_stable

    scale_m /= np.sqrt(2.0)
    error_m = levy_stable.rvs(exponent, 0.0, scale=scale_m, size=size, random_state=rng)
    return np.clip(error_m, -0.1, 0.1)  # the detection knows the size of the ball


@dataclass(frozen=True)
class Conditions(SimConfig):
    """The world of a run, the same for all variants in a comparison.

    The simulator's parameters, and what only the laboratory changes.
    """

    simulation: ClassVar[type[Simulation]] = Simulation

    #: Further noise on each coordinate, m, and its stability exponent; 2 for white noise.
    position_noise_m: float = 0.001
    noise_exponent: float = 2.0
    #: Rotation vector, camera frame, degrees, by which the camera has been carried round the scene
    #: since the networks were trained; it still looks at the scene.
    camera_carried_deg: Vector = (0.0, 0.0, 0.0)
    #: From the middle of the scene, m; 0 for that of the front camera.
    camera_distance_m: float = 0.0


def _carried_camera(rotation_rad: np.ndarray, distance_m: float) -> RigidPose:
    """The front camera, carried round the scene by a rotation vector in its own frame, rad.

    The Jacobian rotates with it. The ball stays in view; a rotation by 30 degrees on the spot would
    lose it. With a distance it is also carried so far from the scene's middle, m.
    """
    camera = CAMERAS["front"]
    scene_m = np.array([0.47, 0.1, 0.33])  # about where the ball is at home, world frame
    away_m = camera.position_m - scene_m
    if distance_m:
        away_m *= distance_m / np.linalg.norm(away_m)
    local = rotation_from_vector(rotation_rad)
    rotation = camera.rotation @ local
    return RigidPose(scene_m + rotation @ camera.rotation.T @ away_m, rotation)


def simulation_of(conditions: Conditions) -> Simulation:
    """The process's simulation, put under these conditions; to be reset before use."""
    config = SimConfig(
        physics_rate_hz=conditions.physics_rate_hz,
        feature=conditions.feature,
        tag=conditions.tag,
        object_tag_id=conditions.object_tag_id,
        object_tag_size_m=conditions.object_tag_size_m,
        object_tag_layout=conditions.object_tag_layout,
    )
    simulation = built(config, conditions.simulation)  # type: ignore[arg-type]
    carried_rad = np.radians(conditions.camera_carried_deg)
    camera = _carried_camera(carried_rad, conditions.camera_distance_m)
    simulation.configure(replace(conditions, camera_pose=camera))
    scale_m, exponent = conditions.position_noise_m, conditions.noise_exponent
    noise = partial(stable_noise_m, scale_m, exponent) if exponent < 2.0 else None
    simulation.position_noise = noise
    return simulation


@lru_cache(maxsize=4)
def built(config: SimConfig, simulation: type[Simulation] = Simulation) -> Simulation:
    """The process's simulation of a robot and a scene."""
    return simulation(config)


@dataclass(frozen=True)
class Bump:
    """A blow to the camera, after which the target is where it was in the room."""

    #: After the target was given, s; if negative, the arm rests so long between blow and target.
    time_s: float
    #: Rotation vector about the camera's own centre, camera frame, degrees.
    rotation_deg: Vector
    #: In the world frame, or that of the link that carries the camera, m.
    translation_m: Vector

    def strike(self, simulation: Simulation) -> None:
        """Move the camera."""
        view = simulation.views[0]
        rotated = view.mounted.rotated(np.radians(self.rotation_deg))
        view.mounted = rotated.moved(np.array(self.translation_m))


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

    def now(self, drift_m: np.ndarray | None = None) -> np.ndarray | None:
        """Find the measurement of the last image, (m,)."""
        return None if super().now() is None or self.newest is None else self.newest.z


@dataclass(frozen=True)
class Trial:
    """A scheme in a case under conditions; without its case, a variant of a comparison."""

    scheme: Scheme = SCHEMES["proposed"]
    conditions: Conditions = field(default_factory=Conditions)
    #: Columns of the tidy table that tell it from the others.
    labels: Mapping[str, Any] = field(default_factory=dict)
    case: Case | None = None
    #: Time from the target on, s.
    duration_s: float = 4.0
    #: End when the error has been below 5 mm for this time, s; for searches.
    stop_after_s: float | None = None
    #: Whether to keep the time series.
    record: bool = False
    #: A blow to the camera.
    bump: Bump | None = None
    #: For a moving target: its position, camera frame, m, at a time, s.
    path: Callable[[float], np.ndarray] | None = None
    #: Whether the ball is predicted from its exposure to now; else the last image counts.
    predicts: bool = True
    #: Whether the estimator learns, if it can.
    learns: bool = True
    #: Makes an estimator that no registry has.
    estimator_of: Callable[[Simulation, Case], Estimator] | None = None

    def changed(
        self,
        labels: Mapping[str, Any] | None = None,
        *,
        controller: Mapping[str, Any] | None = None,
        estimator: Mapping[str, Any] | None = None,
        conditions: Mapping[str, Any] | None = None,
        method: str = "",
        **fields: Any,
    ) -> Trial:
        """The same with further labels, and changes.

        Of the nodes' parameters, the conditions, the scheme's method, and fields of the trial.
        """
        scheme = replace(
            self.scheme,
            method=method or self.scheme.method,
            estimator_values={**self.scheme.estimator_values, **(estimator or {})},
            controller_values={**self.scheme.controller_values, **(controller or {})},
        )
        world = replace(self.conditions, **(conditions or {}))
        labels = {**self.labels, **(labels or {})}
        return replace(self, scheme=scheme, conditions=world, labels=labels, **fields)

    def loop(self, simulation: Simulation) -> ClosedLoop:
        """The whole loop in a simulation that has been reset."""
        scheme = self.scheme
        if self.estimator_of is None:
            estimator = make_estimator(scheme.method, simulation, scheme.estimator_values)
        else:
            assert self.case is not None
            estimator = self.estimator_of(simulation, self.case)
        loop = ClosedLoop(simulation, estimator, {"law": scheme.law, **scheme.controller_values})
        loop.estimation.learns = self.learns
        if not self.predicts:
            loop.loop.eyes[0].track = LastImage(loop.kind)
        return loop


def crossed(variants: Iterable[Trial], cases: Iterable[Case]) -> list[Trial]:
    """Each variant in each case."""
    pairs = product(variants, list(cases))
    return [
        replace(variant, case=case, labels={**variant.labels, "case": case.name})
        for variant, case in pairs
    ]


def photo(simulation: Simulation) -> np.ndarray:
    """What the camera sees now, uint8, (H, W, 3)."""
    simulation.full_frames = True
    frame = simulation.look().frame
    simulation.full_frames = False
    assert frame is not None
    return frame[0]


def sees_all(
    conditions: Conditions, joints_rad: Iterable[Joints | np.ndarray], bump: Bump | None = None
) -> bool:
    """Whether the camera sees it at all of these joints, rad, (n,) each, also after a bump."""
    simulation = simulation_of(conditions)
    cameras = [simulation.camera]
    if bump is not None:
        bump.strike(simulation)
        cameras.append(simulation.camera)
    for camera, joints in product(cameras, joints_rad):
        simulation.camera = camera
        simulation.reset(joints)
        if not _sees(simulation):
            return False
    return True


def _sees(simulation: Simulation) -> bool:
    """Whether the camera sees enough of it, three times in a row."""
    return all(simulation.look().visible_fraction >= 0.9 for _ in range(3))


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
        pair, positions_m = draw(), []
        for joints in pair:
            simulation.reset(joints)
            if not _sees(simulation):
                break
            positions_m.append(simulation.true_pose().position_m)
        else:
            if low_m <= length(positions_m[1] - positions_m[0]) <= high_m:
                start, goal = map(tuple, pair.tolist())
                yield start, goal


# ---- runs -----------------------------------------------------------------------------------


def run_trial(trial: Trial) -> dict[str, Any]:
    """Run one trial; the same to the bit in whatever process."""
    return drive(trial, simulation_of(trial.conditions))


def drive(trial: Trial, simulation: Simulation) -> dict[str, Any]:
    """Run one trial in a simulation that has been put under its conditions.

    Returns its row of the tidy table: its labels, the columns of :func:`outcome`,
    ``jacobian_error`` (relative, in use until it settled), ``target_m`` (the last target, camera
    frame, m) and ``series``, which is empty unless recorded: ``time_s`` (n,), ``feature_m`` and
    ``exponent`` (n, m), ``error_m`` (n,), ``command_rad_s`` (n, joints).
    """
    case, bump, path = trial.case, trial.bump, trial.path
    assert case is not None
    simulation.reset(case.start_rad, case.seed)
    loop = trial.loop(simulation)
    loop.run(0.4)  # for the controller's inputs to be fresh
    if bump is not None and bump.time_s < 0.0:
        bump.strike(simulation)
        loop.run(-bump.time_s)
    target_m = np.empty(0) if path else give_target(loop, case.goal_rad)
    start_s, next_s = simulation.time_s, 0.0
    bump_tick = -1 if bump is None else round(bump.time_s / loop.period_s)
    times_s: list[float] = []
    features_m: list[np.ndarray] = []
    errors_m: list[float] = []
    commands: list[Command] = []
    jacobian_errors: list[float] = []
    below_since_s = np.inf
    for tick in range(round(trial.duration_s / loop.period_s)):
        if bump is not None and tick == bump_tick:
            bump.strike(simulation)
            target_m = give_target(loop, case.goal_rad)
        if path is not None:
            now_s = tick * loop.period_s
            if now_s >= next_s:
                loop.set_target(path(now_s))
                next_s += 1.0 / 30.0  # as often as a camera would
            target_m = path(now_s + loop.period_s)
        commands.append(loop.tick())
        times_s.append(simulation.time_s - start_s)
        features_m.append(loop.true_feature)
        errors_m.append(length(loop.kind.error(features_m[-1], target_m)))
        if tick % JACOBIAN_EVERY == 0:
            jacobian_errors.append(jacobian_error(loop))
        near = errors_m[-1] < SETTLED_ERROR_M
        below_since_s = min(below_since_s, times_s[-1]) if near else np.inf
        if trial.stop_after_s is not None and times_s[-1] - below_since_s >= trial.stop_after_s:
            break
    series = {}
    if trial.record:
        none = np.full(loop.kind.size, np.nan)
        outputs = (command.output for command in commands)
        series = {
            "time_s": np.array(times_s),
            "feature_m": np.array(features_m),
            "error_m": np.array(errors_m),
            "command_rad_s": np.array([command.velocity_rad_s for command in commands]),
            "exponent": np.array([out.exponent if out else none for out in outputs]),
        }
    judged = outcome(np.array(times_s), np.array(errors_m), commands)
    moving = np.array(times_s[::JACOBIAN_EVERY]) <= judged["to_5mm_s"]
    return {
        **trial.labels,
        **judged,
        "jacobian_error": float(np.mean(np.array(jacobian_errors)[moving])),
        "target_m": tuple(target_m.tolist()),
        "series": series,
    }


def outcome(
    times_s: np.ndarray, errors_m: np.ndarray, commands: Sequence[Command]
) -> dict[str, Any]:
    """Judge a run of n ticks: times since the target was given, s, and true errors, m, (n,)."""
    speeds = np.array([command.velocity_rad_s for command in commands])
    settled_s, fine_s = (
        float("inf") if (time_s := settling_time_s(times_s, errors_m, bound)) is None else time_s
        for bound in (SETTLED_ERROR_M, FINE_ERROR_M)
    )
    last = times_s > times_s[-1] - FINAL_S
    serving = commands[-1].state is State.SERVOING
    jitter = np.sqrt(np.mean(np.diff(speeds[last], axis=0) ** 2, axis=0))
    settled = bool(np.isfinite(settled_s))
    return {
        "settled": settled,
        # Time after which the error stayed below a bound; infinite for never.
        "to_5mm_s": settled_s,
        "to_2mm_s": fine_s,
        # Error when the target was given, and over the last second, rms.
        "start_distance_m": float(errors_m[0]),
        "final_rms_m": float(np.sqrt(np.mean(errors_m[last] ** 2))),
        # Change of the command from tick to tick over the last second, rms, worst joint; infinite
        # for an arm that the supervisor held, since its rest is no merit of the law.
        "jitter_rad_s": float(jitter.max()) if serving else float("inf"),
        "peak_joint_speed_rad_s": float(np.abs(speeds).max()),
        "failure": "" if settled else _cause(times_s, errors_m, commands[-1]),
    }


def _cause(times_s: np.ndarray, errors_m: np.ndarray, end: Command) -> str:
    """Why a run did not settle."""
    if end.state is not State.SERVOING:
        return f"held: {end.reason.name.lower().replace('_', ' ')}"
    if errors_m[times_s > times_s[-1] - FINAL_S].min() < SETTLED_ERROR_M:
        return "reached 5 mm, but did not stay"
    return "too slow" if errors_m[-1] < 0.9 * errors_m[0] else "did not get nearer"


def give_target(loop: ClosedLoop, goal_rad: Joints) -> np.ndarray:
    """Give the goal as the camera sees it now as a target; returns the true one, (m,)."""
    simulation = loop.simulation
    true = simulation.true_chain(loop.kind).position(np.array(goal_rad))
    loop.set_target(simulation.as_seen(true))
    return true


def jacobian_error(loop: ClosedLoop) -> float:
    """Relative Frobenius error of the Jacobian that the controller uses now."""
    true = loop.simulation.true_jacobian(loop.simulation.joints_rad, loop.kind)
    used = loop.loop.jacobian
    return float("nan") if used is None else float(relative_errors(used, true))


def relative_errors(jacobian: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Relative Frobenius errors of one or many Jacobians, shape (..., m, n)."""
    wrong = np.linalg.norm(jacobian - true, axis=(-2, -1))
    return np.asarray(wrong / np.linalg.norm(true, axis=(-2, -1)))
