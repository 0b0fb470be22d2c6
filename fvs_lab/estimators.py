"""Which estimator knows the Jacobian best along a smooth motion: section 4.1 of the paper.

A recording is made once, and all estimators get it. An estimator is always judged on a step
before it learns from it, by the paper's criteria T1 and T2.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from fvs_estimator_node.base import Estimator, MotionStep
from fvs_estimator_node.loop import EstimationLoop
from fvs_estimator_node.motion import MotionConfig, RandomMotion
from fvs_estimator_node.rbf import RbfConfig
from fvs_lab import experiment as lab
from fvs_lab import figures as draw
from fvs_lab.results import Results, label_of
from fvs_lab.trials import BOX_RAD, HOME_RAD, Conditions, along, relative_errors, simulation_of
from fvs_sim_node.simulation import Simulation
from fvs_tools.closed_loop import make_estimator

# ---- contestants and worlds -----------------------------------------------------------------


@dataclass(frozen=True)
class Contestant:
    """An estimator with a start."""

    #: For readers.
    name: str
    #: By the estimators' registry's name, and parameters of the node.
    method: str
    values: Mapping[str, Any] = field(default_factory=dict)
    #: Whether it learns before the scored motion, too.
    hears_prelude: bool = True


def _started(method: str, parameter: str, explored: float, model: float) -> list[Contestant]:
    """An online method that explores from a Jacobian of zero, or starts from the networks'.

    Its parameter has for each the best of eight values: that of least median T1 on three other
    paths, with 1 mm of noise and an exact camera.
    """
    zero = {"online.initial": "zero", "online.initial_deviation_m_rad": 0.5}
    name = method.upper()
    return [
        Contestant(f"{name}, explored", method, {**zero, parameter: explored}),
        Contestant(f"{name}, networks' start", method, {parameter: model}, hears_prelude=False),
    ]


PROPOSED, FROZEN = f"proposed, n1 = {RbfConfig.n1:g}", "networks, frozen"
#: Those that the paper compares the proposed one with.
RIVALS = (
    *_started("lkf", "online.process_noise", 0.01, 0.01),
    *_started("ukf", "online.process_noise", 0.01, 0.01),
    *_started("rls", "online.forgetting", 0.85, 0.7),
)
ESTIMATORS = (
    Contestant(PROPOSED, "rbf"),
    Contestant(FROZEN, "frozen"),
    *RIVALS,
    Contestant("true Jacobian (oracle)", "oracle"),
)
SILENT, NOISE = "no noise", "1 mm noise"
#: Angle by which the camera was carried round the scene, degrees, by the world's name.
WORLDS = {SILENT: 0, NOISE: 0, "rotated by 30°": 30}

# ---- recordings -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Recording:
    """The n steps that all estimators get, with the simulator's ground truth."""

    steps: tuple[MotionStep, ...]
    #: End of each step since the scored motion began, s; in the prelude not above 0. Shape (n,).
    time_s: np.ndarray
    #: True ball motion of each step, camera frame, m, shape (n, m).
    true_d_ball_m: np.ndarray
    #: True Jacobian at each step's ``joints_rad``, m/rad, shape (n, m, joints).
    true_jacobian: np.ndarray


def record(seed: int, simulation: Simulation, duration_s: float) -> Recording:
    """Move a simulated UR5, and record measurements and ground truth.

    The seed determines motion and noise. The motion begins 5 s before the part of this length, s,
    that is scored; its fastest joint moves at 0.4 rad/s.
    """
    prelude_s = 5.0
    config = MotionConfig(
        duration_s=3600.0,  # its end, which is slow, is never reached
        joint_range_rad=tuple(0.9 * BOX_RAD),
        max_joint_velocity_rad_s=0.4,
    )
    motion = RandomMotion(HOME_RAD, config, np.random.default_rng([seed, 1]))
    simulation.reset(HOME_RAD, seed)
    steps = list[MotionStep]()
    recorder = make_estimator("oracle", simulation)
    recorder.learns = True
    # It keeps what others learn from.
    recorder.update = steps.append  # type: ignore[assignment, method-assign]
    loop = EstimationLoop(recorder)
    period_s = 1.0 / simulation.config.joint_state_rate_hz
    joints = simulation.joints_rad
    exposed_rad: dict[int, np.ndarray] = {}  # by microseconds, which survive rounding of sums
    for _ in range(round((prelude_s + duration_s) / period_s)):
        simulation.command(motion.command(simulation.time_s, joints))
        out = simulation.advance()
        joints = out.joints_rad
        for image in out.observations:
            exposed_rad[round(1e6 * image.stamp_s)] = image.joints_rad
            if image.z is not None:
                loop.add_image(image.stamp_s, image.z)
        loop.add_joints(out.time_s, joints)
    ends = np.array([exposed_rad[round(1e6 * step.stamp_s)] for step in steps])
    starts = np.array([exposed_rad[round(1e6 * (step.stamp_s - step.dt_s))] for step in steps])
    kind, chain = simulation.kind, simulation.true_chain()
    return Recording(
        steps=tuple(steps),
        time_s=np.array([step.stamp_s for step in steps]) - prelude_s,
        true_d_ball_m=kind.minus(chain.position(ends), chain.position(starts)),
        true_jacobian=np.array([simulation.true_jacobian(step.joints_rad) for step in steps]),
    )


def jacobians_of(
    estimator: Estimator, recording: Recording, hears_prelude: bool = True
) -> np.ndarray:
    """Jacobians of an estimator, m/rad, (n, m, joints), before it learns from each scored step.

    ``hears_prelude``: whether it also learns from the steps before the scored motion.
    """
    jacobians = []
    for step, time_s in zip(recording.steps, recording.time_s, strict=True):
        if time_s > 0.0:
            jacobians.append(estimator.jacobian(step.joints_rad, step.z))
        if estimator.learns and (time_s > 0.0 or hears_prelude):
            estimator.update(step)
    return np.array(jacobians)


def score(recording: Recording, jacobian: np.ndarray, duration_s: float) -> dict[str, Any]:
    """Columns of an estimator, and series of means over half a second.

    T1 = |dx - J dr|, eq (40), with the true dx; T2 = |x - x_hat|, eqs (41) and (42), where x_hat is
    summed up of the predictions J dr; and the relative error of the Jacobian.
    """
    from scipy.stats import binned_statistic

    scored = recording.time_s > 0.0
    moved_rad = np.array([step.d_joints_rad for step in recording.steps])[scored]
    predicted_m = np.einsum("nij,nj->ni", jacobian, moved_rad)
    wrong_m = recording.true_d_ball_m[scored] - predicted_m
    criteria_m = np.linalg.norm([wrong_m, np.cumsum(wrong_m, axis=0)], axis=2)
    edges_s = np.linspace(0.0, duration_s, round(2.0 * duration_s) + 1)
    means = binned_statistic(recording.time_s[scored], criteria_m, bins=edges_s).statistic
    series = dict(zip(("t1_m", "t2_m"), means, strict=True))
    return {
        "t1_m": float(criteria_m[0].mean()),
        "t2_max_m": float(criteria_m[1].max()),
        "jacobian_error": float(relative_errors(jacobian, recording.true_jacobian[scored]).mean()),
        "series": {"time_s": 0.5 * (edges_s[1:] + edges_s[:-1]), **series},
    }


def judge_all(
    world: str, conditions: Conditions, seed: int, duration_s: float
) -> list[dict[str, Any]]:
    """Make a recording, and judge all on it."""
    axis = np.random.default_rng([seed, 2]).normal(size=3)
    conditions = replace(conditions, camera_carried_deg=along(axis, WORLDS[world]))
    if world == SILENT:
        conditions = replace(conditions, position_noise_m=0.0, depth_noise=0.0)
    recording = record(seed, simulation_of(conditions), duration_s)
    rows, jacobians = [], {}
    for contestant in ESTIMATORS:
        name, method = contestant.name, contestant.method
        estimator = make_estimator(method, simulation_of(conditions), contestant.values)
        jacobian = jacobians_of(estimator, recording, contestant.hears_prelude)
        columns = score(recording, jacobian, duration_s)
        row = {"world": world, "estimator": name, "case": seed, **columns}
        jacobians[name] = jacobian
        if method == "ukf":
            twin = jacobians[name.replace("UKF", "LKF")]
            row["lkf_difference_m_rad"] = float(np.abs(jacobian - twin).max())
        rows.append(row)
    return rows


def measure(context: lab.Context) -> Results:
    """Record and judge."""
    duration_s = 3.0 if context.quick else 20.0
    conditions = Conditions(rendered=not context.quick)
    jobs = [
        (world, conditions, seed, duration_s)
        for world in WORLDS
        for seed in range(1, context.count(6) + 1)
    ]
    return Results(context.rows(judge_all, jobs, "estimators: recordings"))


# ---- claims, tables and figures -------------------------------------------------------------


def claims(runs: Results) -> Iterator[lab.Claim]:
    """The paper's claims on the estimators."""
    groups = runs.groups("world", "estimator")
    rotated = [world for world, angle in WORLDS.items() if angle and (world, PROPOSED) in groups]

    def best(world: str, criterion: str, names: list[str]) -> str:
        """The least median; those that are equal but for rounding stay in order."""
        return min(
            names, key=lambda name: float(f"{groups[world, name].median(criterion).value:.9g}")
        )

    def less(world: str, name: str, rival: str, criterion: str) -> lab.Part:
        label = f"{label_of(criterion).partition(',')[0]} of {name} over {rival}, {world}"
        return lab.below(label, groups[world, name].over(groups[world, rival], criterion), 1.0)

    def against_best(world: str, criterion: str) -> lab.Part:
        return less(world, PROPOSED, best(world, criterion, [*rivals, *rls]), criterion)

    rivals, rls = (
        [rival.name for rival in RIVALS if (rival.method == "rls") is is_rls]
        for is_rls in (False, True)
    )
    yield lab.papers(
        "unmoved", *(against_best(NOISE, criterion) for criterion in ("t1_m", "t2_max_m"))
    )
    for criterion, title in (("t1_m", "T1"), ("t2_max_m", "the largest T2")):
        parts = [against_best(world, criterion) for world in rotated]
        yield lab.papers("rotated", *parts, criterion=title)
    parts = []
    for world in (NOISE, *rotated):
        others = (best(world, "t1_m", rivals), PROPOSED)
        worst = max(others, key=lambda name: groups[world, name].median("t1_m").value)
        parts.append(less(world, worst, best(world, "t1_m", rls), "t1_m"))
    yield lab.papers("rls", *parts)
    difference = max(runs.values("lkf_difference_m_rad"))
    label = "largest difference of any entry of their Jacobians"
    text = f"{difference:.1g} m/rad (above rounding, 1e-9)"
    yield lab.papers("ukf", lab.Part(label, text, None if difference > 1e-9 else False))
    online = best(SILENT, "t1_m", [*rivals, *rls])
    yield lab.papers("bound", less(SILENT, online, FROZEN, "t1_m"))
    parts = [
        less(world, PROPOSED, FROZEN, criterion)
        for world in rotated
        for criterion in ("t1_m", "jacobian_error")
    ]
    yield lab.papers("update", *parts)
    yield lab.ours("cost", less(NOISE, PROPOSED, FROZEN, "t1_m"))


TABLES = (
    lab.Table("criteria", ("estimator",), ("t1_m:half", "jacobian_error:half"), across="world"),
)


def figures(runs: Results) -> Iterator[lab.Drawn]:
    """Figures 6 and 7 of the paper."""
    looks = {
        contestant.name: {
            "color": draw.COLOURS[contestant.method],
            "linestyle": "-" if contestant.hears_prelude else "--",
            # The UKF broad and pale, behind the LKF's.
            **({"linewidth": 6.0, "alpha": 0.45} if contestant.method == "ukf" else {}),
        }
        for contestant in ESTIMATORS[:-1]
    }
    for name in ("t1", "t2"):
        series_mm = partial(lambda name, row: 1e3 * np.array(row["series"][f"{name}_m"]), name)
        worlds = runs.groups("world").items()
        figure, (axes,) = draw.grid(1, len(worlds), (12.5, 5.6), sharey=True)
        for axis, (world, group) in zip(axes, worlds, strict=True):
            draw.over_time(axis, group, series_mm, "estimator", looks)
            axis.set(title=world, xlabel="time, s", yscale="log")
        axes[0].set_ylabel(f"{name.upper()}, mm")
        draw.legend(figure)
        yield name, figure, {}


EXPERIMENT = lab.Experiment("estimators", measure, claims, TABLES, globals(), figures)
