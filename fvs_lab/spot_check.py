"""The same run twice: in lock step, and through the real nodes over DDS."""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fvs_lab.context import Context
from fvs_lab.experiment import OURS, Claim, Part
from fvs_lab.outcome import BOUNDS_M, seconds
from fvs_lab.results import number_text, span
from fvs_lab.statistics import median
from fvs_lab.trials import PRELUDE_S, Case, Trial, simulation_of
from fvs_ros.paths import program
from fvs_tools.score import settling_time_s

#: The nodes agree if no settling time differs from lock step by more than this: an image period
#: and a few ticks, s.
AGREE_S = 0.05
_TARGET_S = 3.0
_TIMEOUT_S = 90.0


@dataclass(frozen=True)
class SpotCheck:
    """Settling times to 5 mm of one scheme, target after target, s; None for never.

    Parameters
    ----------
    name : str
        The scheme, and what is unusual.
    lock_step_s : sequence of sequence
        Of the lock-step runs, a row for each seed of the noise.
    nodes_s : sequence
        Of the real nodes; empty if they did not run.
    problem : str
        Why they did not; empty if they did.
    """

    name: str
    lock_step_s: Sequence[Sequence[float | None]]
    nodes_s: Sequence[float | None]
    problem: str

    def ranges_s(self) -> list[tuple[float, float]]:
        """Least and largest lock-step time of each target, s; infinite for never."""
        columns = zip(*self.lock_step_s, strict=True)
        return [(min(map(seconds, times)), max(map(seconds, times))) for times in columns]

    def shifts_s(self) -> list[float]:
        """How much later the nodes settle than the median lock-step run, target by target, s.

        The noise differs in every run and decides when the error is last above 5 mm; a delay that
        lock step does not know would show in all targets.
        """
        columns = zip(*self.lock_step_s, strict=True)
        expected = [median([seconds(time) for time in times]).value for times in columns]
        late = [seconds(node) - one for node, one in zip(self.nodes_s, expected, strict=True)]
        return [one if np.isfinite(one) else float("inf") for one in late]

    def shift_s(self) -> float:
        """The median of the targets' shifts, s."""
        return median(self.shifts_s()).value

    def worst_s(self) -> float:
        """The shift of the target that is furthest off, s."""
        return max(self.shifts_s(), key=abs)


@dataclass(frozen=True)
class Chain:
    """One start, several targets, one after another.

    Parameters
    ----------
    trial : Trial
        Estimator, law, gains and conditions.
    start_rad : tuple of float
        Joints at the start, rad.
    targets_m : tuple of tuple of 3 float
        The targets, camera frame, m.
    seed : int
        Of the noise.
    """

    trial: Trial
    start_rad: tuple[float, ...]
    targets_m: tuple[tuple[float, ...], ...]
    seed: int


def spot_checks(
    context: Context, trials: Mapping[str, Trial], cases: Sequence[Case], experiment: str
) -> list[SpotCheck]:
    """Servo from the first case's start to every case's target, in lock step and by the nodes.

    Parameters
    ----------
    context : Context
        For its cores, and the folder of the scenario files and of the nodes' results.
    trials : mapping of str to Trial
        Estimator, law, gains and conditions by the scheme's name, and what is unusual; a quick run
        checks the first.
    cases : sequence of Case
        The first one's start, and all targets.
    experiment : str
        Whose folder it is.
    """
    if not context.nodes:
        return []
    folder = context.folder(experiment)
    checks = []
    for number, name in enumerate(list(trials)[: 1 if context.quick else None]):
        simulation = simulation_of(trials[name].conditions)
        targets = []
        for case in cases:
            simulation.reset(case.goal_rad)
            targets.append(tuple(float(part) for part in simulation.true_ball_position()))
        chains = [
            Chain(trials[name], cases[0].start_rad, tuple(targets), cases[0].seed + seed)
            for seed in range(2 if context.quick else 6)
        ]
        lock_step = context.map(run_chain, chains, f"{name} in lock step")
        print(f"   {name} through the real nodes ...", flush=True)
        # Other processes' nodes and other checks' must not be heard.
        domain = 1 + (os.getpid() + number) % 100
        checks.append(SpotCheck(name, lock_step, *_through_nodes(chains[0], folder, name, domain)))
    return checks


def _through_nodes(
    chain: Chain, folder: Path, name: str, domain: int
) -> tuple[list[float | None], str]:
    """Settling times of the real nodes, and what went wrong."""
    name = re.sub(r"\W+", "_", name)
    scenario, results = folder / f"spot_check_{name}.yaml", folder / f"spot_check_{name}"
    scenario.write_text(
        yaml.safe_dump(scenario_of(chain, results), sort_keys=False), encoding="utf-8"
    )
    path = results / "results.json"
    path.unlink(missing_ok=True)
    try:
        ended = subprocess.run(
            [
                *(*program("fvs_tools.launcher"), str(scenario)),
                *("--namespace", "fvs_spot_check"),
            ],
            # Whatever the shell says: these commands must not reach a robot of the network.
            env={
                **os.environ,
                "ROS_DOMAIN_ID": str(domain),
                "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            },
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
    scores = json.loads(path.read_text(encoding="utf-8"))
    return [one["settling_5mm_s"] for one in scores], ""


def run_chain(chain: Chain) -> list[float | None]:
    """Servo to all targets in lock step; settling times to 5 mm, s."""
    trial = chain.trial
    simulation = simulation_of(trial.conditions)
    simulation.reset(chain.start_rad, chain.seed)
    one = trial.loop(simulation)
    one.run(PRELUDE_S)
    settling = []
    for target in chain.targets_m:
        target_m = np.array(target)
        one.set_target(target_m)
        errors = []
        for _ in range(round(_TARGET_S / one.period_s)):
            one.tick()
            errors.append(np.linalg.norm(simulation.true_ball_position() - target_m))
        times = one.period_s * np.arange(1, len(errors) + 1)
        settling.append(settling_time_s(times, np.array(errors), BOUNDS_M["5 mm"]))
    return settling


def scenario_of(chain: Chain, results: Path) -> Mapping[str, Any]:
    """The chain as a scenario: the same parameters, given to the nodes."""
    trial, conditions = chain.trial, chain.trial.conditions
    if not conditions.rendered or any(conditions.camera_turn_deg[:2]):
        raise ValueError(
            "the nodes have a rendered camera, turned about its optical axis at most: about "
            "another one, the scene would be out of its sight"
        )

    def parameters(**values: Any) -> dict[str, Any]:
        return {"ros__parameters": values}

    return {
        "fvs_sim_node": parameters(
            seed=chain.seed,
            initial_joints_rad=list(chain.start_rad),
            latency_s=conditions.latency_s,
            depth_noise=conditions.depth_noise,
            position_noise_m=conditions.position_noise_m,
            joint_lag_s=conditions.joint_lag_s,
            camera_rotation_deg=list(conditions.camera_turn_deg),
        ),
        "fvs_estimator_node": parameters(
            method=trial.method, model_path=trial.model, **trial.estimator_values
        ),
        "fvs_controller_node": parameters(law=trial.law, autostart=True, **trial.controller_values),
        "fvs_demo_node": parameters(
            target_positions="; ".join(
                " ".join(f"{number:.6f}" for number in target) for target in chain.targets_m
            ),
            target_s=_TARGET_S,
            output_dir=str(results),
        ),
    }


def rows(checks: Sequence[SpotCheck]) -> list[dict[str, str]]:
    """The table's rows, one per scheme."""
    return [
        {
            "scheme": one.name,
            "lock step, range, s": ", ".join(span(ends) for ends in one.ranges_s()),
            "nodes, s": one.problem
            or ", ".join(number_text(seconds(time), 2) for time in one.nodes_s),
            "shift (median), s": "" if one.problem else f"{one.shift_s():+.2f}",
            "worst target, s": "" if one.problem else f"{one.worst_s():+.2f}",
        }
        for one in checks
    ]


def claims(checks: Sequence[SpotCheck]) -> Iterator[Claim]:
    """The claim ``spot_check``: the nodes settle as lock step does; none without a check."""
    if checks:
        yield Claim("spot_check", OURS, [_part(one) for one in checks])


def _part(one: SpotCheck) -> Part:
    if one.problem:
        return Part(one.name, one.problem, None)
    worst = abs(one.worst_s())
    text = f"{one.worst_s():+.2f} s, asked: at most {AGREE_S} s either way"
    return Part(f"{one.name}, target that differs most", text, worst <= AGREE_S, worst / AGREE_S)
