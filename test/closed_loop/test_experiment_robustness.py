"""Random worlds: pure functions of a number, the same on every engine, judged and drawn."""

import json
import re
import shlex
import sys
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("joblib")
pytest.importorskip("matplotlib")
pytest.importorskip("jinja2")

from scipy.stats import binomtest, levy_stable, norm

from fvs_lab import cluster, main, robustness
from fvs_lab.context import Context
from fvs_lab.noise import WHITE, StableNoise
from fvs_lab.report import Origin, write_page, write_report
from fvs_lab.robustness import CONTESTANTS, contestants_called
from fvs_lab.robustness_figures import DISTURBANCES, colours_of, varied
from fvs_lab.robustness_runs import (
    DURATION_S,
    Contestant,
    Job,
    judged,
    run_job,
    settled_by,
    wins,
)
from fvs_lab.robustness_verdicts import best_of, verdicts
from fvs_lab.robustness_worlds import (
    DISTANCE_M,
    EVERYDAY,
    HARSH,
    QUANTITIES,
    draw_world,
)
from fvs_lab.statistics import wilson
from fvs_lab.trials import NOT_STAYED, Bump, Outcome, Trial, drive, make_cases
from fvs_sim_node.simulation import SimConfig, Simulation
from fvs_tools.schemes import SCHEMES

INF = float("inf")
ORACLE = Contestant("oracle", "oracle", "proportional")
#: A turn of the camera by half a degree, 3 cm aside.
BUMP = Bump(1.0, (0.0, 0.5, 0.0), (0.0, 0.03, 0.0))


def outcome(settled_s=1.0, failure=""):
    times = dict.fromkeys(("5 mm", "2 mm", "1 mm"), None if failure else settled_s)
    return Outcome(0.3, times, 0.0005, 0.001, 0.5, 1.0, 0.0, 0.01, failure, (0.0, 0.0, 1.0))


def outcomes(settled, failed, settled_s=1.0):
    return [outcome(settled_s)] * settled + [outcome(failure="too slow")] * failed


# ---- worlds ---------------------------------------------------------------------------------


def test_a_world_is_a_function_of_seed_and_number():
    world = draw_world(HARSH, 3)
    others = [draw_world(HARSH, 4), draw_world(replace(HARSH, seed=7), 3)]
    assert draw_world(HARSH, 3) == world
    for other in others:
        assert other.case.seed != world.case.seed
        assert other.conditions.latency_s != world.conditions.latency_s


def test_worlds_keep_their_ranges_and_differ_in_kind():
    worlds = [draw_world(HARSH, number) for number in range(1, 13)]
    for world in worlds:
        assert DISTANCE_M[0] <= world.distance_m <= DISTANCE_M[1]
        for one in QUANTITIES:
            low, high = HARSH.ranges[one.name]
            value = getattr(world.conditions, one.name)
            assert low <= value <= high or (one.name, value) == ("noise_exponent", WHITE), one
        assert world.turn_deg <= HARSH.ranges["camera_turn_deg"][1]
        assert all(0 <= one.bin_of(world) < len(one.bins) for one in DISTURBANCES)
        assert f"{world.case.seed}" in world.words()
    assert 0 < sum(world.bump is not None for world in worlds) < len(worlds)
    assert 0 < sum(world.conditions.noise_exponent == WHITE for world in worlds) < len(worlds)


def test_everyday_worlds_differ_in_start_target_camera_and_drives():
    worlds = [draw_world(EVERYDAY, number) for number in range(1, 9)]
    for world in worlds:
        one = world.conditions
        assert (one.position_noise_m, one.latency_s, one.dropout) == (0.001, 0.05, 0.1)
        assert (world.bump, one.noise_exponent) == (None, WHITE)
    assert len({world.turn_deg for world in worlds}) == len(worlds)
    assert DISTURBANCES[2] not in varied(worlds), "no camera is bumped"
    assert 2 < len(varied(worlds)) < len(DISTURBANCES)
    assert varied(worlds[:1]) == DISTURBANCES[:1]
    assert len({world.case.start_rad for world in worlds}) == len(worlds)


@pytest.mark.parametrize("exponent", [1.6, WHITE])
def test_noise_is_alpha_stable(exponent):
    noise, rng = StableNoise(0.001, exponent), np.random.default_rng(1)
    errors_m = np.concatenate([noise(rng) for _ in range(20_000)])
    true = (
        norm(scale=0.001)
        if exponent == WHITE
        else levy_stable(exponent, 0.0, scale=0.001 / np.sqrt(2.0))
    )
    for bound_m in (-0.003, -0.0005, 0.0, 0.001, 0.01):
        assert np.mean(errors_m < bound_m) == pytest.approx(true.cdf(bound_m), abs=0.006)
    assert np.abs(errors_m).max() <= 0.1
    assert (np.abs(errors_m).max() > 0.05) == (exponent < WHITE)


def test_noise_in_place_of_the_configured_one_is_the_runs_own():
    with Simulation(SimConfig(rendered=False, position_noise_m=0.001)) as simulation:
        simulation.position_noise = lambda rng: np.full(3, 0.02) + 0.0 * rng.random()
        seen = simulation.look()
        error_m = seen.detection.position_m - seen.true_position_m
        np.testing.assert_allclose(error_m, 0.02, atol=1e-12)


# ---- runs -----------------------------------------------------------------------------------


def small_jobs():
    """Runs by exact positions: two worlds, one of them with a bump, two schemes."""
    worlds = [draw_world(HARSH, number) for number in (1, 2)]
    worlds[1] = replace(worlds[1], bump=replace(BUMP, time_s=0.2))
    return [
        Job(world, one, rendered=False, record=True)
        for world in worlds
        for one in (CONTESTANTS[0], ORACLE)
    ]


def flat(results):
    return [
        (repr(one.summary()), {name: value.tobytes() for name, value in one.series.items()})
        for one in results
    ]


@pytest.fixture(scope="module")
def here():
    return flat(run_job(job) for job in small_jobs())


def test_the_same_results_come_from_one_process_and_from_two(here, tmp_path):
    assert flat(Context(tmp_path, jobs=2).map(run_job, small_jobs(), "test")) == here


def test_the_same_results_come_from_a_cluster(here, tmp_path):
    """Its workers have several threads, which must not share the simulation at one time."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=2, host="127.0.0.1", dashboard_address=None
    ) as machines:
        context = Context(tmp_path, cluster=machines.scheduler_address)
        assert flat(context.map(run_job, small_jobs(), "test")) == here


def test_a_bump_moves_the_camera_and_not_the_ball():
    (case,) = make_cases("t", 1, 6)
    trial = Trial(case, "oracle", "proportional", duration_s=4.0, record=True)
    with Simulation(SimConfig(rendered=False)) as simulation:
        camera, calm = simulation.camera, drive(trial, simulation)
        simulation.camera = camera
        bumped = drive(trial, simulation, BUMP)
    moved = simulation.camera
    np.testing.assert_allclose(
        camera.position_m + camera.rotation @ calm.target_m,
        moved.position_m + moved.rotation @ bumped.target_m,
    )
    same = calm.series["time_s"] < BUMP.time_s
    np.testing.assert_array_equal(calm.series["ball_m"][same], bumped.series["ball_m"][same])
    jump_m = np.abs(np.diff(bumped.series["error_m"])).max()
    assert jump_m < 0.01, "the target went along"
    assert not bumped.failure
    assert bumped.settled_s > BUMP.time_s
    assert bumped.path_ratio < calm.path_ratio + 1.0


def test_staying_for_the_last_second_is_asked_for():
    assert judged(outcome(DURATION_S - 1.5)).failure == ""
    late = judged(outcome(DURATION_S - 0.5))
    assert late.failure == NOT_STAYED
    assert late.settled_s == INF


# ---- numbers --------------------------------------------------------------------------------


@pytest.mark.parametrize(("hits", "count"), [(0, 4), (3, 4), (4, 4), (495, 500)])
def test_the_interval_of_a_share_is_that_of_scipy(hits, count):
    one = wilson(hits, count)
    other = binomtest(hits, count).proportion_ci(method="wilson")
    assert (one.value, one.count) == (hits / count, count)
    assert (one.low, one.high) == pytest.approx((other.low, other.high))


def test_times_by_which_a_share_had_settled():
    ones = [outcome(second) for second in (3.0, 1.0, 2.0)] + outcomes(0, 1)
    assert settled_by(ones, 0.5) == 2.0
    assert settled_by(ones, 0.75) == 3.0
    assert settled_by(ones, 0.9) == INF


def test_only_worlds_that_tell_two_apart_count():
    one, other = outcomes(8, 2), outcomes(2, 8)
    assert wins(one, one) is None
    share = wins(one, other)
    assert (share.value, share.count) == (1.0, 6)
    assert share.above(0.5) is True
    assert wins(other, one).above(0.5) is False


def test_the_verdicts_follow_the_numbers():
    results = {one.name: outcomes(400, 200) for one in CONTESTANTS}
    results["ukf+mpc"] = outcomes(600, 0)
    assert best_of(CONTESTANTS, results).name == "ukf+mpc"
    *enough, lead = verdicts(CONTESTANTS, results)
    assert len(enough) == len(CONTESTANTS)
    assert [one.claim for one in enough if one.holds] == [
        "At least 99 % of the trials of ukf+mpc settle."
    ]
    assert "oracle" in enough[-1].claim
    assert lead.holds
    assert "200 of the 200 worlds" in lead.finding
    results["proposed"] = outcomes(600, 0, 0.9)
    assert best_of(CONTESTANTS, results).name == "proposed"
    assert verdicts(CONTESTANTS, results)[-1].holds is None, "none differs from ukf+mpc"


def test_the_oracle_is_no_competitor():
    results = {one.name: outcomes(1, 9) for one in CONTESTANTS}
    results["oracle, proportional"] = outcomes(10, 0)
    assert best_of(CONTESTANTS, results).name in SCHEMES
    oracle = [one for one in CONTESTANTS if one.knows_truth]
    assert [one.claim for one in verdicts(oracle, results)] == [
        "At least 99 % of the trials of oracle, proportional settle."
    ]


# ---- the whole ------------------------------------------------------------------------------


def test_everybody_is_known_to_the_nodes_and_has_a_colour():
    from fvs_controller_node.config import default_values
    from fvs_estimator_node.config import PARAMETERS
    from fvs_ros.params import ParameterSet

    names = [one.name for one in CONTESTANTS]
    assert set(SCHEMES) < set(names)
    assert len(set(colours_of(names).values())) == len(names)
    for one in CONTESTANTS:
        default_values(law=one.law, **one.controller_values)
        ParameterSet(PARAMETERS).values({"method": one.method, **one.estimator_values})


def test_new_contestants_get_colours_of_their_own():
    names = ["proposed", "oracle, proportional", "rbf, arrive", "poe", "oracle, ftsm"]
    assert len(set(colours_of(names).values())) == len(names)


@pytest.mark.parametrize("number", [37, 86, 88])
def test_a_heavy_tails_worst_image_does_not_throw_an_arm_at_rest_off_its_target(number):
    (best,) = contestants_called(["best"])
    assert not run_job(Job(draw_world(HARSH, number), best, rendered=False)).failure


def test_a_quick_run_makes_a_complete_report(tmp_path):
    context = Context(tmp_path, jobs=2, quick=True, rendered=False, trials=2)
    report = robustness.run(context)
    folder = context.folder(report.name)
    path = write_report(report, folder, Origin("", "", "", True))
    data = json.loads(path.read_text(encoding="utf-8"))["data"]
    assert data["seed"] == HARSH.seed
    assert [world["number"] for world in data["worlds"]] == [1, 2]
    assert {name: len(runs) for name, runs in data["runs"].items()} == {
        "proposed": 2,
        "oracle, proportional": 2,
    }
    assert "The oracle is told" in " ".join(report.setup)
    for figure in report.figures:
        assert (folder / figure.file).stat().st_size > 10_000
    for table in report.tables:
        assert table.rows
        assert {len(row) for row in table.rows} == {len(table.header)}
    assert all(one.holds is None for one in report.verdicts), "two trials decide nothing"
    assert 'id="robustness"' in write_page(tmp_path).read_text(encoding="utf-8")


def test_one_trial_is_looked_at_alone(tmp_path, capsys):
    command = ["robustness", "--trial", "2", "--camera", "exact", "--out", str(tmp_path)]
    assert main.main([*command, "--scheme", "rbf+pid", "--jobs", "1"]) == 0
    printed = capsys.readouterr().out
    assert draw_world(HARSH, 2).words() in printed
    assert "rbf+pid: " in printed
    assert "proposed" not in printed
    assert (tmp_path / "robustness" / "trial_2.png").stat().st_size > 10_000
    assert not (tmp_path / "robustness" / "results.json").exists()
    assert main.main([*command, "--scheme", "none"]) == 2
    assert "known are 'proposed'" in capsys.readouterr().err


def test_a_page_names_a_command_that_makes_it(tmp_path):
    given = ["everyday", "--trials", "1", "--scheme", "rbf+pid"]
    assert main.main([*given, "--jobs", "1", "--out", str(tmp_path)]) == 0
    page = (tmp_path / "index.md").read_text(encoding="utf-8")
    (command,) = re.findall(r"Made by `fvs_experiments (.*?)`", page)
    assert shlex.split(command) == [*given, "--camera", "exact"]


# ---- clusters that are none -----------------------------------------------------------------


def test_a_cluster_without_its_library_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "dask.distributed", None)
    command = ["robustness", "--quick", "--cluster", "tcp://127.0.0.1:1", "--out", str(tmp_path)]
    assert main.main(command) == 2
    assert "pip install distributed" in capsys.readouterr().err


def test_a_cluster_that_does_not_answer_is_refused(tmp_path, monkeypatch, capsys):
    pytest.importorskip("distributed")
    monkeypatch.setattr(cluster, "_ANSWER_S", 0.5)
    command = ["robustness", "--quick", "--out", str(tmp_path), "--cluster"]
    for address in ("tcp://127.0.0.1:1", "nonsense"):
        assert main.main([*command, address]) == 2
        assert f"no dask scheduler answers at {address}" in capsys.readouterr().err


def test_workers_that_are_missing_or_run_other_code_are_refused(tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(cluster, "_ANSWER_S", 2.0)
    with distributed.LocalCluster(
        n_workers=0, host="127.0.0.1", dashboard_address=None
    ) as machines:
        context = Context(tmp_path, cluster=machines.scheduler_address)
        with pytest.raises(cluster.ClusterError, match="has no workers"):
            context.map(abs, [1], "test")
        machines.scale(1)
        machines.wait_for_workers(1)
        monkeypatch.setattr(cluster, "MODEL", __file__)
        with pytest.raises(cluster.ClusterError, match="other code or another model"):
            context.map(abs, [1], "test")
