"""The same run twice: in lock step, and through the real nodes over DDS."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fvs_ros.apps.experiments.lockstep import MODEL, LockStep, load_networks, make_estimator
from fvs_ros.apps.experiments.trials import PRELUDE_S, Case, Conditions, Trial, simulation_of
from fvs_ros.apps.score import settling_time_s

_TARGET_S = 3.0
_BOUND_M = 0.005
_TIMEOUT_S = 90.0


@dataclass(frozen=True)
class SpotCheck:
    """Settling times to 5 mm of one scheme, target after target, s; None for never.

    Parameters
    ----------
    name : str
        The scheme.
    lock_step_s, nodes_s : sequence
        Of the lock-step run, and of the real nodes; the latter empty if they did not run.
    problem : str
        Why they did not; empty if they did.
    """

    name: str
    lock_step_s: Sequence[float | None]
    nodes_s: Sequence[float | None]
    problem: str

    @property
    def largest_difference_s(self) -> float:
        """Largest difference over the targets, s; infinite where only one settled."""
        differences = [0.0]
        for one, other in zip(self.lock_step_s, self.nodes_s, strict=True):
            if one is None or other is None:
                differences.append(0.0 if one is other else float("inf"))
            else:
                differences.append(abs(one - other))
        return max(differences)


def spot_check(
    name: str, trial: Trial, cases: Sequence[Case], folder: Path, domain: int
) -> SpotCheck:
    """Servo from the first case's start to every case's target, twice.

    Parameters
    ----------
    name : str
        The scheme's name.
    trial : Trial
        Estimator, law, gains and conditions.
    cases : sequence of Case
        The first one's start, and all targets.
    folder : Path
        For the scenario file and the nodes' results.
    domain : int
        ``ROS_DOMAIN_ID`` of the nodes.
    """
    simulation = simulation_of(trial.conditions)
    targets = []
    for case in cases:
        simulation.reset(case.goal_rad)
        targets.append(simulation.true_ball_position())
    lock_step = _in_lock_step(trial, cases[0], targets)
    scenario = folder / f"spot_check_{name.replace('+', '_')}.yaml"
    results = folder / f"spot_check_{name.replace('+', '_')}"
    scenario.write_text(
        yaml.safe_dump(scenario_of(trial, cases[0], targets, results), sort_keys=False),
        encoding="utf-8",
    )
    try:
        ended = subprocess.run(
            [sys.executable, "-m", "fvs_ros.apps.launcher", str(scenario)],
            env={**os.environ, "ROS_DOMAIN_ID": str(domain)},
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return SpotCheck(name, lock_step, [], f"the nodes took more than {_TIMEOUT_S:g} s")
    path = results / "results.json"
    if not path.is_file():
        last = (ended.stdout + ended.stderr).strip().splitlines()[-1:]
        return SpotCheck(name, lock_step, [], f"the nodes gave no result: {' '.join(last)}")
    scores = json.loads(path.read_text(encoding="utf-8"))
    return SpotCheck(name, lock_step, [one["settling_5mm_s"] for one in scores], "")


def _in_lock_step(trial: Trial, first: Case, targets: Sequence[np.ndarray]) -> list[float | None]:
    simulation = simulation_of(trial.conditions)
    simulation.reset(first.start_rad, first.seed)
    estimator = make_estimator(trial.method, simulation, load_networks(), trial.estimator_values)
    one = LockStep(simulation, estimator, {"law": trial.law, **trial.controller_values})
    one.run(PRELUDE_S)
    settling = []
    for target_m in targets:
        one.set_target(target_m)
        errors = []
        for _ in range(round(_TARGET_S / one.period_s)):
            one.tick()
            errors.append(np.linalg.norm(simulation.true_ball_position() - target_m))
        times = one.period_s * np.arange(1, len(errors) + 1)
        settling.append(settling_time_s(times, np.array(errors), _BOUND_M))
    return settling


def scenario_of(
    trial: Trial, first: Case, targets: Sequence[np.ndarray], results: Path
) -> Mapping[str, Any]:
    """The trial as a scenario file: the same parameters, given to the nodes."""
    conditions: Conditions = trial.conditions
    if not conditions.rendered or any(conditions.camera_turn_deg):
        raise ValueError("the nodes have a rendered camera, where the model was trained")

    def parameters(**values: Any) -> dict[str, Any]:
        return {"ros__parameters": values}

    return {
        "fvs_sim_node": parameters(
            seed=first.seed,
            initial_joints_rad=list(first.start_rad),
            latency_s=conditions.latency_s,
            depth_noise=conditions.depth_noise,
            position_noise_m=conditions.position_noise_m,
            joint_lag_s=conditions.joint_lag_s,
        ),
        "fvs_estimator_node": parameters(
            method=trial.method, model_path=MODEL, **trial.estimator_values
        ),
        "fvs_controller_node": parameters(law=trial.law, autostart=True, **trial.controller_values),
        "fvs_demo_node": parameters(
            target_positions="; ".join(
                " ".join(f"{number:.6f}" for number in target) for target in targets
            ),
            target_s=_TARGET_S,
            output_dir=str(results),
        ),
    }
