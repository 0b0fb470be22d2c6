"""The same run twice: in lock step, and through the real nodes over DDS."""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fvs_lab.experiment import Claim, Context, Part, ours
from fvs_lab.outcome import seconds
from fvs_lab.results import median
from fvs_lab.trials import PRELUDE_S, Case, Trial, settling_run, simulation_of
from fvs_ros.paths import program
from fvs_tools.closed_loop import MODEL

#: The nodes agree if no settling time differs from lock step by more than this: an image period
#: and a few ticks, s.
AGREE_S = 0.05
_TARGET_S, _TIMEOUT_S = 3.0, 90.0

#: Targets, camera frame, m.
Targets = Sequence[Sequence[float]]


@dataclass(frozen=True)
class SpotCheck:
    """Settling times to 5 mm of one scheme, target after target, s; None for never."""

    #: The scheme, and what is unusual.
    scheme: str
    #: Of the lock-step runs, a row for each seed of the noise.
    lock_step_s: Sequence[Sequence[float | None]]
    #: Of the real nodes; empty if they did not run, and why.
    nodes_s: Sequence[float | None]
    problem: str = ""

    def worst_s(self) -> float:
        """How much later the nodes settle than the median lock-step run, at the worst target, s.

        The noise differs in every run and decides when the error is last above 5 mm.
        """
        columns = zip(*self.lock_step_s, strict=True)
        expected = [median([seconds(time) for time in times]).value for times in columns]
        late = [seconds(node) - one for node, one in zip(self.nodes_s, expected, strict=True)]
        return max((one if np.isfinite(one) else float("inf") for one in late), key=abs)


def spot_checks(
    context: Context, trials: Mapping[str, Trial], cases: Sequence[Case], experiment: str
) -> list[SpotCheck]:
    """Servo from the first case's start to every case's target, in lock step and by the nodes.

    The trials have names for readers; a quick run checks the first. Scenario files and the nodes'
    results go to the experiment's folder.
    """
    if not context.nodes:
        return []
    checks = []
    for number, name in enumerate(list(trials)[: 1 if context.quick else None]):
        simulation = simulation_of(trials[name].conditions)
        targets = []
        for case in cases:
            simulation.reset(case.goal_rad)
            targets.append(simulation.true_ball_position().tolist())
        seeded = [
            replace(trials[name], case=replace(cases[0], seed=cases[0].seed + seed))
            for seed in range(2 if context.quick else 6)
        ]
        in_lock_step = partial(run_chain, targets_m=targets)
        lock_step = context.map(in_lock_step, seeded, f"{name} in lock step")
        print(f"   {name} through the real nodes ...", flush=True)
        # Isolates this check from nodes of other processes and checks.
        domain = 1 + (os.getpid() + number) % 100
        # A smoke test must not depend on how busy this computer is.
        more = ("use_sim_time:=true", "simulated_time:=true") if context.quick else ()
        folder = context.folder(experiment)
        nodes = _through_nodes(seeded[0], targets, folder, name, domain, more)
        checks.append(SpotCheck(name, lock_step, *nodes))
    return checks


def _through_nodes(
    trial: Trial, targets_m: Targets, folder: Path, name: str, domain: int, more: Sequence[str]
) -> tuple[list[float | None], str]:
    """Settling times of the real nodes, and what went wrong."""
    name = re.sub(r"\W+", "_", name)
    scenario, results = folder / f"spot_check_{name}.yaml", folder / f"spot_check_{name}"
    content = scenario_of(trial, targets_m, results)
    scenario.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    path = results / "results.json"
    path.unlink(missing_ok=True)
    # Overrides the shell's environment: these commands must not reach a robot on the network.
    local = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    try:
        ended = subprocess.run(
            [
                *(*program("fvs_tools.launcher"), str(scenario), "--namespace", "fvs_spot_check"),
                *(word for one in more for word in ("-p", one)),
            ],
            env={**os.environ, **local},
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return [], f"the nodes took more than {_TIMEOUT_S:g} s"
    if not path.is_file():
        last = (ended.stdout + ended.stderr).strip().splitlines()[-1:]
        return [], f"the nodes gave no result: {' '.join(last)}"
    return [one["settling_5mm_s"] for one in json.loads(path.read_text(encoding="utf-8"))], ""


def run_chain(trial: Trial, targets_m: Targets) -> list[float]:
    """Servo to one target after the other in lock step; settling times to 5 mm, s."""
    simulation = simulation_of(trial.conditions)
    simulation.reset(trial.case.start_rad, trial.case.seed)
    one = trial.loop(simulation)
    one.run(PRELUDE_S)
    return [settling_run(one, np.array(each), _TARGET_S) for each in targets_m]


def scenario_of(trial: Trial, targets_m: Targets, results: Path) -> Mapping[str, Any]:
    """A chain of targets, camera frame, m, as a scenario: the same parameters for the nodes."""
    conditions, who = trial.conditions, trial.variant
    same = ("latency_s", "depth_noise", "position_noise_m")
    targets = "; ".join(" ".join(f"{one:.6f}" for one in target) for target in targets_m)
    nodes = {
        "fvs_sim_node": {
            "seed": trial.case.seed,
            "initial_joints_rad": list(trial.case.start_rad),
            "camera_rotation_deg": list(conditions.camera_turn_deg),
            **{name: getattr(conditions, name) for name in same},
        },
        "fvs_estimator_node": {
            "method": who.method,
            "model_path": MODEL,
            **who.estimator_values,
        },
        "fvs_controller_node": {"law": who.law, "autostart": True, **who.controller_values},
        "fvs_demo_node": {
            "target_positions": targets,
            "target_s": _TARGET_S,
            "output_dir": str(results),
        },
    }
    return {name: {"ros__parameters": values} for name, values in nodes.items()}


def claims(checks: Sequence[SpotCheck]) -> Iterator[Claim]:
    """The claim ``spot_check``: the nodes settle as lock step does; none without a check."""
    yield ours("spot_check", *(_part(one) for one in checks))


def _part(one: SpotCheck) -> Part:
    if one.problem:
        return Part(one.scheme, one.problem, None)
    worst = abs(one.worst_s())
    text = f"{one.worst_s():+.2f} s, asked: at most {AGREE_S} s either way"
    label = f"{one.scheme}, target that differs most"
    return Part(label, text, worst <= AGREE_S, worst / AGREE_S)
