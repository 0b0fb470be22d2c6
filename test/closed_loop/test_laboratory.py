"""Every experiment: its quick run is complete, its runs are repeatable, its numbers are right."""

import json
import re
import shlex
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

pytest.importorskip("joblib")
pytest.importorskip("matplotlib")
pytest.importorskip("jinja2")

from scipy.stats import levy_stable, norm

from fvs_controller_node.config import default_values
from fvs_controller_node.settling import settling_times
from fvs_controller_node.surface import ReachingLaw, SlidingSurface
from fvs_estimator_node.base import Estimator, MotionStep
from fvs_estimator_node.config import PARAMETERS
from fvs_lab import contestants as who
from fvs_lab import main, settling, tuning
from fvs_lab.beyond_runs import (
    AT_REST,
    CARRIED,
    CIRCLE,
    ERRING,
    LINE,
    MOMENTS,
    RADIUS_M,
    UNDISTURBED,
    Minute,
    Pursuit,
    assess,
    draw_journeys,
    draw_paths,
    draw_places,
    learn,
    record,
    run_journey,
    run_pursuit,
)
from fvs_lab.experiment import Context, Found
from fvs_lab.figures import colours_of
from fvs_lab.floor import Limits, fastest
from fvs_lab.report import EXPERIMENTS, Origin, write_page, write_report
from fvs_lab.results import Results
from fvs_lab.robustness import CONTESTANTS, contestants_called, judged, trial_in
from fvs_lab.search import REGIMES, Search
from fvs_lab.settling import BANDS, bound_to_band_s, predicted_times_s, promises_kept
from fvs_lab.smooth_motion import Recording, judge
from fvs_lab.smooth_motion import record as record_motion
from fvs_lab.trials import (
    WHITE,
    Bump,
    Case,
    Conditions,
    StableNoise,
    Trial,
    Variant,
    drive,
    make_cases,
    run_trial,
    simulation_of,
)
from fvs_lab.worlds import DISTANCE_M, DRAWN, EVERYDAY, HARSH, QUANTITIES, draw_world
from fvs_ros.params import ParameterSet
from fvs_sim_node.simulation import SimConfig, Simulation
from fvs_tools.closed_loop import make_estimator
from fvs_tools.schemes import BEYOND, SCHEMES

INF = float("inf")
EXACT = Conditions(rendered=False)
CLEAN = Conditions(rendered=False, position_noise_m=0.0, depth_noise=0.0)


# ---- whole experiments ----------------------------------------------------------------------


#: Whole runs elsewhere: servo's with nodes in test/nodes, everyday's by its own command below.
ELSEWHERE = ("servo", "everyday")


@pytest.mark.timeout(240)
@pytest.mark.parametrize("name", [name for name in EXPERIMENTS if name not in ELSEWHERE])
def test_a_quick_run_makes_a_complete_page(name, tmp_path):
    trials = 2 if name == "robustness" else None
    context = Context(
        tmp_path, seeds=1, jobs=2, quick=True, rendered=False, nodes=False, trials=trials
    )
    report = import_module(f"fvs_lab.{name}").EXPERIMENT.run(context)
    folder = context.folder(name)
    path = write_report(report, folder, Origin("", "", "", True))
    assert json.loads(path.read_text(encoding="utf-8"))["data"]["runs"]
    assert len({figure.file for figure in report.figures}) == len(report.figures) > 0
    for figure in report.figures:
        assert (folder / figure.file).stat().st_size > 10_000
    for table in report.tables:
        assert table.rows
        assert {len(row) for row in table.rows} == {len(table.header)}
    claims = [one.claim for one in report.verdicts]
    assert len(set(claims)) == len(claims) >= 2
    assert {one.whose for one in report.verdicts} <= {"the paper's", "ours"}
    page = write_page(tmp_path, [name]).read_text(encoding="utf-8")
    assert f'<section id="{name}">' in page
    assert page.count("data:image/png;base64,") == len(report.figures)
    markdown = (tmp_path / "index.md").read_text(encoding="utf-8")
    assert markdown.index(claims[-1]) < markdown.index("<details>")


# ---- runs -----------------------------------------------------------------------------------


def small_trials():
    """Runs by exact positions: two worlds, one of them with a bump, two schemes."""
    worlds = [draw_world(HARSH, number) for number in (1, 2)]
    worlds[1] = replace(worlds[1], bump=Bump(0.2, (0.0, 0.5, 0.0), (0.0, 0.03, 0.0)))
    return [
        replace(trial_in(world, one, rendered=False, record=True), duration_s=1.0)
        for world in worlds
        for one in (CONTESTANTS[0], CONTESTANTS[-1])
    ]


def test_the_same_runs_come_from_one_process_and_from_two(tmp_path):
    here = [run_trial(trial) for trial in small_trials()]
    there = Context(tmp_path, jobs=2).map(run_trial, small_trials(), "test")
    for one, other in zip(here, there, strict=True):
        assert one.settling_s == other.settling_s
        for name, values in one.series.items():
            np.testing.assert_array_equal(values, other.series[name])


def test_a_bump_moves_the_camera_and_not_the_ball():
    (case,) = make_cases("t", 1, 6)
    bump = Bump(1.0, (0.0, 0.5, 0.0), (0.0, 0.03, 0.0))
    trial = Trial(Variant({}, "oracle", "proportional"), case, duration_s=4.0, record=True)
    with Simulation(SimConfig(rendered=False)) as simulation:
        camera, calm = simulation.camera, drive(trial, simulation)
        simulation.camera = camera
        bumped = drive(replace(trial, bump=bump), simulation)
    moved = simulation.camera
    np.testing.assert_allclose(
        camera.position_m + camera.rotation @ calm.target_m,
        moved.position_m + moved.rotation @ bumped.target_m,
    )
    same = calm.series["time_s"] < bump.time_s
    np.testing.assert_array_equal(calm.series["ball_m"][same], bumped.series["ball_m"][same])
    assert np.abs(np.diff(bumped.series["error_m"])).max() < 0.01, "the target went along"
    assert not bumped.failure
    assert bumped.settled_s > bump.time_s
    assert bumped.path_ratio < calm.path_ratio + 1.0


@pytest.mark.parametrize("number", [37, 88])
def test_a_heavy_tails_worst_image_does_not_throw_an_arm_at_rest_off_its_target(number):
    (best,) = contestants_called(["best"])
    assert not judged(run_trial(trial_in(draw_world(HARSH, number), best, rendered=False))).failure


def test_everybody_is_known_to_the_nodes_and_has_a_colour():
    parameters = ParameterSet(PARAMETERS)
    names = [one.name for one in CONTESTANTS]
    assert set(SCHEMES) < set(names)
    assert len(set(colours_of([*names, "poe", "oracle, ftsm"]).values())) == len(names) + 2
    case = Case("", (0.0,) * 6, (0.1,) * 6, 0)
    trials = [who.variant(name).trial(case, EXACT) for name in who.CONTESTANTS]
    searched = {**who.TUNED, **who.CALM}
    trials += [Search.of(one, REGIMES[0]).trial({}, case, EXACT) for one in searched.values()]
    for trial in trials:
        variant = trial.variant
        default_values(law=variant.law, **variant.controller_values)
        parameters.values({"method": variant.method, **variant.estimator_values})
        assert variant.controller_values["max_joint_velocity_rad_s"] == who.SPEED_RAD_S
    for scheme in searched.values():
        least_speed = scheme.controller_values.get("redundancy_resolution") == "least_speed"
        assert least_speed is (scheme.law in who.ALLOCATED)
    for scheme in BEYOND.values():
        assert who.CONTESTANTS[scheme.name] == scheme


@pytest.mark.parametrize("knob", tuning.KNOBS, ids=lambda knob: knob.name)
def test_a_knob_turns_a_parameter_about_its_default(knob):
    assert knob.default in knob.values
    known = ParameterSet(PARAMETERS).values if knob.of_estimator else lambda x: default_values(**x)
    for value in knob.values:
        settings = knob.settings(value)
        known(settings)
        if value == knob.default:
            defaults = known({})
            assert {name: defaults[name] for name in settings} == pytest.approx(settings)


# ---- random worlds --------------------------------------------------------------------------


def test_a_world_is_a_function_of_seed_and_number():
    world = draw_world(HARSH, 3)
    assert draw_world(HARSH, 3) == world
    for other in (draw_world(HARSH, 4), draw_world(replace(HARSH, seed=7), 3)):
        assert other.case.seed != world.case.seed
        assert other.conditions.latency_s != world.conditions.latency_s


def test_worlds_keep_their_ranges_and_differ_in_kind():
    worlds = [draw_world(HARSH, number) for number in range(1, 13)]
    for world in worlds:
        row = world.row()
        assert DISTANCE_M[0] <= row["distance_m"] <= DISTANCE_M[1]
        assert row["turn_deg"] <= HARSH.ranges["camera_turn_deg"][1]
        for one in DRAWN:
            low, high = HARSH.ranges[one.name]
            assert low <= row[one.name] <= high or row[one.name] == WHITE, one
        assert all(0 <= one.bin_of(row[one.name]) < len(one.bins) for one in QUANTITIES)
        assert f"{world.case.seed}" in world.text()
    assert 0 < sum(world.bump is not None for world in worlds) < len(worlds)
    assert 0 < sum(world.conditions.noise_exponent == WHITE for world in worlds) < len(worlds)
    usual = draw_world(EVERYDAY, 1)
    assert (usual.bump, usual.conditions.noise_exponent) == (None, WHITE)
    assert usual.conditions.position_noise_m == 0.001


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


def test_one_trial_is_looked_at_alone(tmp_path, capsys):
    command = ["robustness", "--trial", "2", "--camera", "exact", "--out", str(tmp_path)]
    assert main.main([*command, "--scheme", "rbf+pid", "--jobs", "1"]) == 0
    printed = capsys.readouterr().out
    assert draw_world(HARSH, 2).text() in printed
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


# ---- settling time: formula and bounds ------------------------------------------------------

SURFACE = SlidingSurface(alpha2=1.0, alpha3=0.6)
REACHING = ReachingLaw(k1=1.5, k2=0.1, k4=0.2, sigma=0.75)
ERRORS = np.array([[0.3, -0.1, 0.02], [0.05, 0.2, -0.2], [0.004, 0.001, 0.0]])


@pytest.mark.parametrize("error", ERRORS)
def test_motion_band_bound_and_bound_to_zero_are_in_order(error):
    to_zero = max(
        one.total_s for one in settling_times(error.tolist(), [0.0] * 3, SURFACE, REACHING)
    )
    predicted = predicted_times_s(error[None, :], SURFACE, REACHING)
    for band in BANDS:
        to_band = bound_to_band_s(error, BANDS[band], SURFACE, REACHING)
        assert predicted[band][0] <= to_band + 0.002
        assert to_band <= to_zero
    assert bound_to_band_s(0.01 * error, 0.005, SURFACE, REACHING) == 0.0


def settling_claims(*runs):
    usual = {
        "gains": "0.19 → 0.5", "world": settling.SILENT, "excluded": "",
        "to_5mm_s": 1.0, "to_2mm_s": 1.0, "bound_s": 2.0, "band_5mm_s": 1.2, "band_2mm_s": 1.2,
        "predicted_5mm_s": 1.0, "printed_s": -0.5, "printed_sliding_s": -0.7,
    }  # fmt: skip
    rows = [{**usual, **run} for run in runs]
    found = Found(Results({**row, **promises_kept(row)} for row in rows))
    return {one.name: one for one in settling.claims(found)}


def test_settling_claims_follow_the_shares():
    good = settling_claims(*20 * [{}])
    assert [good[name].holds for name in ("bound", "band", "motion")] == [True] * 3
    assert good["printed"].holds is False
    late = settling_claims(*18 * [{}], *2 * [{"to_5mm_s": INF}])["bound"]
    assert late.holds is False
    assert "18 of 20 (90.0 %)" in late.decisive.measured
    kept = settling_claims(*20 * [{"printed_s": 5.0, "printed_sliding_s": 4.0}])
    assert kept["printed"].holds is True
    # Runs outside the assumptions do not count.
    excluded = 20 * [{"to_5mm_s": INF, "excluded": "a limit shaped the command"}]
    assert "5 of 5" in settling_claims(*5 * [{}], *excluded)["bound"].decisive.measured
    assert settling_claims(*excluded)["bound"].holds is None


# ---- estimators -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def clean():
    return record_motion(3, CLEAN, 2.0)


def test_the_oracle_errs_by_micrometres_without_noise(clean):
    oracle = make_estimator("oracle", simulation_of(CLEAN))
    track = judge(oracle, clean, True)
    assert track.t1_m.max() < 1e-5
    assert track.jacobian_error.max() < 1e-12


class KnowsTheLastStep(Estimator):
    """Explains each step exactly, once it has seen it."""

    def __init__(self):
        self.reset()

    def jacobian(self, joints_rad):
        return self.learned.copy()

    def update(self, step):
        moved = step.d_joints_rad
        self.learned = np.outer(step.d_ball_m, moved) / (moved @ moved)

    def reset(self):
        self.learned = np.zeros((3, 6))


def made_up(balls_m, first_s=0.1):
    """Each step moves joint 1 by 0.1 rad; one step each 0.1 s."""
    moved = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    times = first_s + 0.1 * np.arange(len(balls_m))
    steps = tuple(
        MotionStep(float(t), 0.1, np.zeros(6), moved, np.asarray(ball, dtype=float))
        for t, ball in zip(times, balls_m, strict=True)
    )
    true = np.ones((len(steps), 3, 6))
    return Recording(steps, times, np.array(balls_m, dtype=float), true, 1.0, 0.0)


def test_an_estimator_is_judged_before_it_learns_and_errors_add_up():
    balls_m = [[0.01, 0.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.02, 0.0]]
    track = judge(KnowsTheLastStep(), made_up(balls_m), True)
    np.testing.assert_allclose(track.t1_m, [0.01, np.hypot(0.01, 0.02), 0.0], atol=1e-15)
    # the errors (10, 0), (-10, 20) and (0, 0) mm, summed up
    np.testing.assert_allclose(track.t2_m, [0.01, 0.02, 0.02], atol=1e-15)
    for hears, t1_m in ((True, 0.0), (False, 0.01)):
        prelude = made_up([[0.01, 0.0, 0.0]] * 2, first_s=0.0)
        track = judge(KnowsTheLastStep(), prelude, hears)
        np.testing.assert_allclose(track.t1_m, [t1_m], atol=1e-15)


# ---- beyond the paper -----------------------------------------------------------------------


def test_best_is_close_to_the_floor_and_the_same_when_repeated():
    (case,) = make_cases("t", 1, 5)
    trial = who.variant(who.BEST).trial(case, EXACT, duration_s=2.0)
    one, again = run_trial(trial), run_trial(trial)
    assert one == again
    least_s = fastest(case, Limits(who.SPEED_RAD_S, who.ACCELERATION_RAD_S2), 0.005).time_s
    assert least_s < one.settled_s < 1.2 * least_s


def test_images_are_stamped_late_and_the_fit_finds_out():
    minute = Minute(3, 12.0, EXACT, draw_places(1, 10), "ridge")
    data, late_s = record(minute)
    np.testing.assert_array_equal(data.ball_m, record(minute)[0].ball_m)
    learned = learn(minute)
    assert learned["late_s"] == late_s > 0.01
    assert learned["late_error_s"] < 0.003
    assert learned["chain_box"] < 0.01 < learned["paper_box"]
    assert learned["distilled_box"] < 0.02


@pytest.mark.parametrize("plant", ERRING)
def test_a_fit_says_how_far_it_is_off_from_what_the_camera_sees(plant):
    conditions = replace(EXACT, **ERRING[plant])
    row = assess((plant, Minute(3, 40.0, conditions, draw_places(1, 20))))
    assert 0.5 < row["honesty"] < 2.0
    # in metres, a wrong scale of the camera is not told
    assert (row["metric"] > 3.0 * row["stated"]) == (plant == "depths told 0.5 % too large")


@pytest.mark.parametrize("name", [who.BEST, who.EXTENDED])
def test_a_camera_that_moves_while_the_ball_rests_costs_little_time(name):
    before = simulation_of(EXACT).camera
    journeys = draw_journeys(1, 7, (name,), EXACT)
    assert [one.moment for one in journeys] == list(MOMENTS)
    turn = np.array(journeys[0].bump.rotation_deg)
    assert np.linalg.norm(turn) == pytest.approx(45.0)
    assert abs(turn[2]) > 35.0, "mostly about the optical axis"
    settled_s = {one.moment: run_journey(one)["to_5mm_s"] for one in journeys}
    assert settled_s[AT_REST] <= 1.2 * settled_s[UNDISTURBED]
    assert settled_s[CARRIED] <= 1.2 * settled_s[UNDISTURBED]
    np.testing.assert_array_equal(simulation_of(EXACT).camera.rotation, before.rotation)
    assert run_journey(journeys[0])["to_5mm_s"] == settled_s[UNDISTURBED]


def test_paths_begin_at_the_ball_and_keep_their_shape():
    line, circle = draw_paths(1, 8)
    assert (line.kind, circle.kind) == (LINE, CIRCLE)
    simulation = simulation_of(Conditions())
    for path in (line, circle):
        simulation.reset(path.start_rad)
        np.testing.assert_allclose(path.at(0.0), simulation.true_ball_position(), atol=1e-9)
        step = path.at(0.1001) - path.at(0.1)
        assert np.linalg.norm(step) == pytest.approx(0.0001, rel=1e-4)
    half = circle.at(np.pi * RADIUS_M)
    assert np.linalg.norm(half - circle.at(0.0)) == pytest.approx(2.0 * RADIUS_M)
    assert line.duration_s(0.3) == pytest.approx(line.length_m / 0.3)


def test_feed_forward_is_what_keeps_up():
    pursuit = Pursuit(who.EXTENDED, draw_paths(1, 8)[1], 0.1, True, EXACT)
    with_it, alone = (
        run_pursuit(replace(pursuit, feed_forward=feed_forward))["rms_m"]
        for feed_forward in (True, False)
    )
    assert with_it < 0.003 < alone < 0.03
