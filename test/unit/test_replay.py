"""What a replay says of recordings in which everything is known."""

import importlib.util
import json
import resource
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("rosbags")

from replayed_bags import (
    BEGIN_S,
    COMMAND_AGE_S,
    DECAY_1_S,
    END_S,
    GIVEN_S,
    IMAGE_AGE_S,
    JACOBIAN,
    JOINT_AGE_S,
    START_M,
    TARGET_M,
    TYPES,
    HandmadeBag,
    servo,
)
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin

from fvs_controller_node.reasons import State
from fvs_lab.main import main
from fvs_lab.replay import estimates, figures, files, overview, runs, story, timing
from fvs_lab.replay.data import Series
from fvs_lab.replay.files import BagError
from fvs_lab.replay.happened import happened
from fvs_lab.replay.reading import read
from fvs_lab.replay.sections import sections
from fvs_lab.report import Origin, write_report
from fvs_lab.style import pyplot
from fvs_ros.status import SILENT
from fvs_tools.bag import Bag, Message

DEMO = {
    "fvs_controller_node": {"law": "ftsm", "max_joint_velocity_rad_s": 0.8},
    "fvs_estimator_node": {"method": "rbf", "model_path": "models/ur5_front.npz"},
}


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """One target, one gap of the images, one warning."""
    folder = tmp_path_factory.mktemp("replay") / "run_1"
    made = HandmadeBag(folder, scenario=DEMO)
    servo(made, gap=(3.0, 3.5))
    made.log(2.0, "fvs_sim_node", "something odd")
    made.log(2.1, "fvs_sim_node", "something odd")
    made.log(2.2, "fvs_sim_node", "all is well", level=20)
    made.log(2.3, "fvs_controller_node", "SERVOING: said by the status already")
    made.close()
    return folder


@pytest.fixture(scope="module")
def recording(bag):
    return read(bag)


def simple(folder, storage=StoragePlugin.MCAP, namespace="", **options):
    made = HandmadeBag(folder, storage, namespace)
    servo(made, **options)
    made.close()
    return folder


@pytest.fixture
def undrawn(monkeypatch):
    """Figures are made, but not drawn: that takes most of the time of a replay."""
    for module in (figures, overview):
        monkeypatch.setattr(module, "save", lambda figure, _: pyplot().close(figure))


# --- targets ---


def test_a_target_is_judged_by_the_true_ball(recording):
    (target,) = runs.targets(recording)
    assert not target.moving
    assert target.score.start_distance_m == pytest.approx(0.3)
    for bound_m, settled_s in (
        (0.005, target.score.settling_5mm_s),
        (0.002, target.score.settling_2mm_s),
    ):
        exact_s = np.log(0.3 / bound_m) / DECAY_1_S
        assert exact_s <= settled_s < exact_s + 0.0081
    assert target.path_m == pytest.approx(0.3, rel=1e-4)
    assert target.score.peak_joint_speed_rad_s == pytest.approx(2.4, rel=0.04)
    assert runs.judged_by(recording).topic == "/fvs_sim_node/true_ball_position"


def test_without_the_truth_the_measured_ball_is_taken(tmp_path):
    recording = read(simple(tmp_path / "bag", true=False))
    assert runs.judged_by(recording).topic == "/ball_position"
    (target,) = runs.targets(recording)
    assert target.score.settling_5mm_s == pytest.approx(np.log(60) / DECAY_1_S, abs=0.04)


def test_a_target_said_again_is_the_same_and_a_new_one_is_another(tmp_path):
    made = HandmadeBag(tmp_path / "bag")
    servo(made)
    made.point("target_position", 1.7, GIVEN_S, TARGET_M)
    made.point("target_position", 3.0, None, START_M)  # by hand, without a stamp
    made.close()
    first, second = runs.targets(read(tmp_path / "bag"))
    assert first.record.time_s[-1] <= 2.0 + 1e-6
    assert second.record.start_s == pytest.approx(BEGIN_S + 3.0)
    assert second.score.start_distance_m == pytest.approx(0.3, abs=0.001)
    assert second.score.settling_5mm_s is None


def told(made, from_s, to_s, target_m):
    """The controller's status, ten times a second, with the target that it has."""
    for number in range(round(10 * from_s), round(10 * to_s)):
        x, y, z = (f"{value:.6g}" for value in target_m)
        made.status(
            "fvs_controller_node",
            0.1 * number + 0.01,
            "servoing",
            state="SERVOING",
            reason="SERVOING",
            target_x_m=x,
            target_y_m=y,
            target_z_m=z,
        )


def test_a_refused_target_is_none_and_one_set_by_a_service_ends_the_one_before(tmp_path):
    made = HandmadeBag(tmp_path / "bag")
    servo(made)
    made.point("target_position", 2.0, None, [5.0, 5.0, 5.0])  # refused: the first goes on
    told(made, GIVEN_S, 4.0, TARGET_M)
    told(made, 4.0, END_S, START_M)
    made.close()
    recording = read(tmp_path / "bag")
    (target,) = runs.targets(recording)
    np.testing.assert_allclose(target.record.target_m, TARGET_M)
    assert target.record.time_s[-1] == pytest.approx(4.0 - GIVEN_S, abs=0.05)


def test_targets_in_quick_succession_are_one_that_moves(tmp_path):
    made = HandmadeBag(tmp_path / "bag")
    servo(made)
    for step in range(1, 40):
        time_s = GIVEN_S + 0.1 * step
        aside = TARGET_M + [0.0, 0.01 * min(step, 20), 0.0]
        made.point("target_position", time_s, time_s, aside)
    made.close()
    (target,) = runs.targets(read(tmp_path / "bag"))
    assert target.moving
    late = target.errors_m[np.array(target.record.time_s) > 3.0]
    assert late == pytest.approx(0.2, abs=0.001)


def test_a_target_that_is_repeated_and_then_another_are_two_that_stand(tmp_path):
    made = HandmadeBag(tmp_path / "bag")
    servo(made)
    for step in range(1, 40):
        time_s = GIVEN_S + 0.1 * step
        aside_m = 0.15 if step > 20 else 0.0
        made.point("target_position", time_s, time_s, TARGET_M + [0.0, aside_m, 0.0])
    made.close()
    first, second = runs.targets(read(tmp_path / "bag"))
    assert not first.moving
    assert not second.moving
    assert second.record.start_s - first.record.start_s == pytest.approx(2.1, abs=0.01)


@pytest.mark.parametrize("aside_m", [0.03, 0.15])
def test_a_target_after_a_while_is_another_however_near(tmp_path, aside_m):
    made = HandmadeBag(tmp_path / "bag")
    servo(made)
    made.point("target_position", 2.0, 2.0, TARGET_M)  # said again just before
    made.point("target_position", 2.1, 2.1, TARGET_M + [0.0, aside_m, 0.0])
    made.close()
    found = runs.targets(read(tmp_path / "bag"))
    assert [one.moving for one in found] == [False, False]


def test_a_demo_ends_its_last_target_after_its_time(tmp_path):
    made = HandmadeBag(tmp_path / "bag", scenario={"fvs_demo_node": {"target_s": 2.0}})
    servo(made)
    made.close()
    (target,) = runs.targets(read(tmp_path / "bag"))
    assert target.record.time_s[-1] == pytest.approx(2.0, abs=1e-6)


def test_a_demo_s_last_sample_is_the_demo_s_own_to_the_last_digit(recording):
    times_s = np.array([nth // 125 + (nth % 125 * 8_000_000) * 1e-9 for nth in range(2000)])
    still = np.tile(START_M, (2000, 1))
    for start_s in times_s[250:1250]:
        series = {
            "true_ball": Series("/true", times_s, times_s, still),
            "target": Series("/target", np.array([start_s]), np.array([start_s]), TARGET_M[None]),
        }
        demo = {"fvs_demo_node": {"target_s": 1.6}}
        (target,) = runs.targets(replace(recording, series=series, scenario=demo))
        since_s = target.record.time_s
        assert since_s[-1] >= 1.6 > since_s[-2], start_s


def cut_at(recording, since_given_s):
    """The recording as a file that ends so long after the target was given, s."""
    end_s = recording.start_s + GIVEN_S + since_given_s
    series = {}
    for key, one in recording.series.items():
        kept = one.arrival_s <= end_s + 0.0011  # of the ball's true position, its stamp
        series[key] = Series(one.topic, one.arrival_s[kept], one.stamp_s[kept], one.values[kept])
    return replace(recording, series=series, end_s=end_s)


#: When the ball in the handmade bag comes below 5 and 2 mm, s.
BELOW_5_S, BELOW_2_S = np.log(60) / DECAY_1_S, np.log(150) / DECAY_1_S
COARSE, FINE = "settling_5mm_s", "settling_2mm_s"
LAST = ("final_rms_m", "jitter_rad_s")


@pytest.mark.parametrize(
    ("ends_s", "not_known"),
    [
        (0.9, {COARSE, FINE, *LAST}),  # on its way: no "never"
        (BELOW_5_S + 0.05, {COARSE, FINE, *LAST}),  # just crossing
        (BELOW_5_S + 0.95, {COARSE, FINE, *LAST}),
        (BELOW_5_S + 1.05, {FINE}),
        (BELOW_2_S + 1.05, set()),
    ],
)
def test_what_a_recording_ends_too_early_for_is_not_known(recording, ends_s, not_known):
    (whole,) = runs.targets(recording)
    assert whole.not_known == {}
    (target,) = runs.targets(cut_at(recording, ends_s))
    assert target.not_known == dict.fromkeys(not_known, "the recording ends")
    for name in (COARSE, FINE):
        expected = None if name in not_known else getattr(whole.score, name)
        assert getattr(target.score, name) == expected
    for value, name in zip((target.score.final_rms_m, target.jitter_rad_s), LAST, strict=True):
        assert np.isnan(value) == (name in not_known)


def test_a_demo_s_target_of_its_whole_time_is_judged_as_by_the_demo(recording):
    demo = {"fvs_demo_node": {"target_s": 1.5}}  # below 5 mm after 1.02 s
    (whole,) = runs.targets(replace(recording, scenario=demo))
    assert whole.not_known == {}
    assert BELOW_2_S <= whole.score.settling_2mm_s < BELOW_2_S + 0.0081
    assert np.isfinite([whole.score.final_rms_m, whole.jitter_rad_s]).all()
    (cut,) = runs.targets(cut_at(replace(recording, scenario=demo), 1.4))
    assert set(cut.not_known) == {COARSE, FINE, *LAST}


@pytest.mark.parametrize(
    ("after_s", "not_known"), [(0.9, set(LAST)), (1.3, {COARSE, FINE, *LAST}), (2.5, set())]
)
def test_another_target_leaves_unknown_whether_the_ball_stayed(tmp_path, after_s, not_known):
    made = HandmadeBag(tmp_path / "bag")
    servo(made)
    made.point("target_position", GIVEN_S + after_s, GIVEN_S + after_s, START_M)
    made.close()
    first, _ = runs.targets(read(tmp_path / "bag"))
    assert first.not_known == dict.fromkeys(not_known, "another target came")
    if after_s == 0.9:  # while it was there, the ball never was
        assert (first.score.settling_5mm_s, first.score.settling_2mm_s) == (None, None)


@pytest.mark.parametrize(("lasts_s", "known"), [(3.0, False), (5.0, True)])
def test_a_ball_that_stays_away_was_never_there_once_it_had_a_demo_s_time(tmp_path, lasts_s, known):
    made = HandmadeBag(tmp_path / "bag")
    for tick in range(round(lasts_s / 0.008) + 1):
        time_s = 0.008 * tick
        made.point("ball_position", time_s, time_s, START_M)
    made.point("target_position", 0.0, 0.0, TARGET_M)
    made.close()
    (target,) = runs.targets(read(tmp_path / "bag"))
    assert target.score.settling_5mm_s is None
    assert (COARSE not in target.not_known) is known


def test_the_page_says_not_known_and_why(recording, tmp_path, undrawn):
    report = sections(cut_at(recording, BELOW_5_S + 1.05), tmp_path)[1]
    (row,) = report.tables[0].rows
    assert row[2].endswith(" s")
    assert row[3] == "not known"
    assert "Of target 1 not all is known: the recording ends before" in report.setup[1]
    (told,) = report.data["targets"]
    assert told["not_known"] == {FINE: "the recording ends"}
    row = sections(cut_at(recording, 0.9), tmp_path)[1].tables[0].rows[0]
    assert row[2:5] == ["not known"] * 3
    assert row[-1] == "not known"
    report = sections(recording, tmp_path)[1]
    assert len(report.setup) == 1
    assert "not known" not in report.tables[0].rows[0]


def test_a_target_from_before_the_recording_counts_from_its_stamp(tmp_path):
    made = HandmadeBag(tmp_path / "bag", scenario=DEMO)
    servo(made)
    made.close()
    recording = read(tmp_path / "bag")
    true = recording.series["true_ball"]
    late = true.stamp_s > BEGIN_S + GIVEN_S + 0.5
    kept = Series(true.topic, true.arrival_s[late], true.stamp_s[late], true.values[late])
    given = recording.series["target"]
    early = Series(given.topic, np.zeros(1), given.stamp_s, given.values)  # no clock heard yet
    series = {**recording.series, "true_ball": kept, "target": early}
    (target,) = runs.targets(replace(recording, series=series))
    assert target.begins_late
    assert target.score.settling_5mm_s == pytest.approx(np.log(60) / DECAY_1_S, abs=0.009)


# --- messages that their readers would have refused, or that lack something ---


def test_points_that_are_not_finite_or_of_another_frame_are_passed_over(tmp_path):
    made = HandmadeBag(tmp_path / "bag")
    servo(made, true=False)
    for nth, bad in enumerate(([np.nan, 0.0, 1.0], [0.0, np.inf, 1.0])):
        made.point("ball_position", 2.0 + nth, 1.99 + nth, bad)
        made.point("target_position", 2.0 + nth, 1.99 + nth, bad)
    made.point("ball_position", 2.5, 2.49, [9.0, 9.0, 9.0], frame="base_link")
    made.point("target_position", 2.5, 2.49, [9.0, 9.0, 9.0], frame="base_link")
    made.close()
    recording = read(tmp_path / "bag")
    assert len(recording.series["ball"]) == round(END_S * 30)
    assert np.array_equal(recording.series["target"].values, [TARGET_M])
    assert len(recording.flows["/ball_position"].arrival_s) == round(END_S * 30) + 3
    assert main(["replay", str(tmp_path / "bag"), "--out", str(tmp_path / "page")]) == 0


@pytest.mark.parametrize("told", [True, False])
def test_the_loop_s_own_frame_is_what_it_was_started_with_or_the_ball_s(tmp_path, told):
    scenario = {"fvs_controller_node": {"feature_frame": "eye"}} if told else None
    made = HandmadeBag(tmp_path / "bag", scenario=scenario)
    for nth in range(3):
        made.point("ball_position", 0.1 * nth, 0.1 * nth, TARGET_M, frame="eye")
    made.point("target_position", 0.2, 0.2, START_M, frame="eye")
    made.point("target_position", 0.3, 0.3, TARGET_M)
    made.close()
    series = read(tmp_path / "bag").series
    assert len(series["ball"]) == 3
    assert np.array_equal(series["target"].values, [START_M])


def test_jacobians_and_commands_that_are_not_finite_are_passed_over(tmp_path):
    made = HandmadeBag(tmp_path / "bag")
    servo(made)
    made.array("jacobian", 2.0, np.full((3, 6), np.nan))
    made.array("forward_velocity_controller/commands", 2.0, [np.inf] * 6)
    made.close()
    series = read(tmp_path / "bag").series
    assert np.isfinite(series["jacobian"].values).all()
    assert np.isfinite(series["commands"].values).all()


@pytest.mark.parametrize("speeds", [(), np.full(6, np.nan)])
def test_joint_states_without_velocities_keep_their_positions(tmp_path, speeds, monkeypatch):
    made = HandmadeBag(tmp_path / "bag")
    with_speeds = made.joints
    monkeypatch.setattr(
        made, "joints", lambda at_s, stamp_s, angles, _: with_speeds(at_s, stamp_s, angles, speeds)
    )
    servo(made)
    made.close()
    recording = read(tmp_path / "bag")
    joints = recording.series["joints"].values
    assert np.isfinite(joints[:, :6]).all()
    assert np.isnan(joints[:, 6:]).all()
    assert estimates.prediction(recording).t1_m.max() < 1e-4
    (target,) = runs.targets(recording)
    assert np.isnan(target.score.peak_joint_speed_rad_s)
    assert main(["replay", str(tmp_path / "bag"), "--out", str(tmp_path / "page")]) == 0
    assert "nan" not in (tmp_path / "page" / "index.md").read_text(encoding="utf-8")


# --- timing ---


def test_rates_ages_and_latencies(recording):
    found = {one.topic: one for one in timing.rhythms(recording)}
    joints = found["/joint_states"]
    assert joints.rate_hz == pytest.approx(125.0, rel=1e-3)
    assert joints.jitter_s < 1e-6
    assert joints.age_s == pytest.approx(JOINT_AGE_S, abs=1e-6)
    assert found["/ball_position"].age_s == pytest.approx(IMAGE_AGE_S, abs=1e-6)
    assert found["/ball_position"].longest_s == pytest.approx(0.5 + 2 / 30, abs=0.04)
    assert np.isnan(found["/jacobian"].age_s)
    _, latency_s = timing.command_latencies_s(
        recording.series["ball"], recording.series["commands"]
    )
    assert np.median(latency_s) == pytest.approx(COMMAND_AGE_S, abs=0.004)


def every(start_s, end_s, period_s, age_s=0.0):
    """A topic's messages, each so old when it comes."""
    arrival_s = np.arange(start_s, end_s, period_s)
    return Series("/topic", arrival_s, arrival_s - age_s, np.zeros((len(arrival_s), 6)))


def test_an_image_is_late_only_where_commands_are_sent(recording, tmp_path):
    sent = [every(start_s, start_s + 2.0, 0.008) for start_s in (30.0, 50.0)]
    commands = Series("/commands", *(np.concatenate([s.arrival_s for s in sent]),) * 2, np.empty(0))
    ball = every(0.0, 60.0, 1 / 30, 0.04)
    arrival_s, latency_s = timing.command_latencies_s(ball, commands)
    assert latency_s.max() <= 0.04 + 0.008 + 1e-6
    assert arrival_s.size == pytest.approx(2 * 60, abs=2)
    assert ((arrival_s >= 30.0) & (arrival_s < 32.0) | (arrival_s >= 50.0)).all()
    # A controller that is slow is no silence.
    slow = every(0.0, 10.0, 0.5)
    _, latency_s = timing.command_latencies_s(every(1.0, 9.0, 1 / 30), slow)
    assert latency_s.size == 240
    assert latency_s.max() == pytest.approx(0.5, abs=0.04)


def test_a_silence_of_the_images_is_found(recording):
    (gap,) = timing.gaps(recording)
    assert gap.topic == "/ball_position"
    assert gap.start_s - recording.start_s == pytest.approx(3.0, abs=0.05)
    assert gap.length_s == pytest.approx(0.55, abs=0.04)


# --- the story ---


def test_states_follow_one_another_with_their_first_sentence(recording):
    waiting, servoing = story.states(recording)
    assert (waiting.what, waiting.reason) == ("WAITING", "NO_TARGET")
    assert servoing.what == "SERVOING"
    assert servoing.sentence == "servoing, 300.0 mm to go"
    assert servoing.start_s - recording.start_s == pytest.approx(GIVEN_S)
    assert servoing.end_s == recording.end_s
    assert story.on_the_way(recording) == [servoing]


def test_a_controller_that_says_no_more_is_silent_and_not_still_servoing(tmp_path):
    made = HandmadeBag(tmp_path / "bag")
    servo(made)
    made.point("target_position", END_S + 5.0, None, START_M)  # the bag goes on
    made.close()
    recording = read(tmp_path / "bag")
    *_, servoing, silent = story.states(recording)
    assert servoing.what == "SERVOING"
    assert (silent.what, silent.sentence) == ("SILENT", "no word from the controller")
    assert servoing.end_s == silent.start_s
    assert silent.start_s - recording.start_s == pytest.approx(END_S + 0.9, abs=0.05)
    assert silent.end_s == recording.end_s


ZEROS = "forward_velocity_controller/commands"


def ended(folder, joints_end_s, last_command=0.0, **last_word):
    """A loop that was ended: the controller's last commands, joint states and recorder go on."""
    made = HandmadeBag(folder)
    servo(made)
    if last_word:
        made.status("fvs_controller_node", END_S + 0.02, "the end", **last_word)
    for tick in range(1, 6):
        made.array(ZEROS, END_S + 0.01 * tick, np.full(6, last_command))
    for tick in range(round((joints_end_s - END_S) / 0.1)):
        at_s = END_S + 0.1 * (tick + 1)
        made.joints(at_s, at_s, np.zeros(6), np.zeros(6))
    made.log(END_S + 12.0, "fvs_recorder_node", "the recorder's own", level=20)
    made.close()
    return read(folder)


def test_a_controller_that_left_zeros_as_the_loop_was_ended_is_not_silent(tmp_path):
    recording = ended(tmp_path / "bag", END_S + 2.0)
    *_, servoing, end = story.states(recording)
    assert servoing.what == "SERVOING"
    assert (end.what, end.sentence) == ("ENDED", "the loop was being ended")
    assert servoing.end_s == end.start_s == pytest.approx(BEGIN_S + END_S + 0.05, abs=1e-3)
    assert end.end_s == recording.end_s


def test_a_controller_that_says_that_it_shuts_down_is_not_silent_after_that(tmp_path):
    recording = ended(
        tmp_path / "bag", END_S + 11.0, 0.1, state="HOLDING", reason="SHUT_DOWN"
    )  # its robot goes on
    assert [one.what for one in story.states(recording)][-2:] == ["HOLDING", "ENDED"]


@pytest.mark.parametrize(("joints_end_s", "last_command"), [(9.0, 1e-4), (16.0, 0.0)])
def test_a_controller_that_was_killed_is_silent(tmp_path, joints_end_s, last_command):
    recording = ended(tmp_path / "bag", joints_end_s, last_command)
    assert [one.what for one in story.states(recording)][-2:] == ["SERVOING", "SILENT"]


def test_an_end_without_commands_or_joint_states_in_the_bag_is_a_silence(tmp_path):
    recording = ended(tmp_path / "bag", END_S + 2.0)
    for key in ("commands", "joints"):
        series = {name: one for name, one in recording.series.items() if name != key}
        assert story.states(replace(recording, series=series))[-1].what == SILENT


def test_an_active_limit_is_a_spell(recording):
    (limit,) = story.limits(recording)
    assert limit.what == "near singular"  # without the number, which is another one each time
    assert limit.end_s - limit.start_s == pytest.approx(0.5)


def test_a_limit_s_share_is_of_the_time_on_the_way_and_not_of_the_rest(tmp_path, undrawn):
    made = HandmadeBag(tmp_path / "bag")
    for number in range(101):
        time_s = 0.1 * number
        settled = time_s >= 2.0 - 1e-9
        limit = "joint speed" if time_s < 0.5 - 1e-9 else "near singular" if time_s >= 1.5 else ""
        made.status(
            "fvs_controller_node",
            time_s,
            "servoing",
            state="SERVOING",
            reason="SETTLED" if settled else "SERVOING",
            active_limit=limit,
        )
    made.close()
    recording = read(tmp_path / "bag")
    (way,) = story.on_the_way(recording)
    assert way.end_s - way.start_s == pytest.approx(2.0)
    *_, table = happened(recording, [], (0.005, 0.002), tmp_path).tables
    assert table.header == ["limit", "for, s", "of the time on the way"]
    assert table.rows == [["near singular", "8.50", "25 %"], ["joint speed", "0.50", "25 %"]]


def test_warnings_and_silences_are_events_in_order(recording):
    events = story.events(recording)
    assert [(one.who, one.times) for one in events] == [("fvs_sim_node", 2), ("/ball_position", 1)]
    assert events[1].text.startswith("silent for 0.5")


@pytest.mark.parametrize("namespace", ["", "/left"])
def test_only_the_controller_s_own_words_are_not_said_twice(tmp_path, namespace):
    made = HandmadeBag(tmp_path / "bag", namespace=namespace)
    servo(made)
    before = f"{namespace[1:]}." if namespace else ""
    blind = "WAITING: no colour images on camera/color/image_raw; is the camera's driver running?"
    made.log(0.5, f"{before}fvs_detector_node", blind)
    made.log(0.6, f"{before}fvs_controller_node", "WAITING: no ball_position yet")
    made.log(0.7, f"{before}fvs_controller_node", "target refused: it is out of the workspace")
    made.log(0.8, "right.fvs_controller_node", "WAITING: no joint_states yet")
    made.close()
    assert [(one.who, one.text) for one in story.events(read(tmp_path / "bag"))] == [
        (f"{before}fvs_detector_node", blind),
        (f"{before}fvs_controller_node", "target refused: it is out of the workspace"),
        ("right.fvs_controller_node", "WAITING: no joint_states yet"),
    ]


def test_of_a_long_story_beginning_and_end_are_on_the_page_and_all_in_the_numbers(tmp_path, capsys):
    made = HandmadeBag(tmp_path / "bag")
    for k in range(200):
        made.status(
            "fvs_controller_node",
            0.1 * k,
            f"said {k}",
            state="HOLDING" if k % 2 else "SERVOING",
            reason=f"R{k % 2}",
        )
    made.array("jacobian", 30.0, JACOBIAN)
    made.close()
    assert main(["replay", str(tmp_path / "bag"), "--out", str(tmp_path / "page")]) == 0
    said = capsys.readouterr().out
    page = (tmp_path / "page" / "index.md").read_text(encoding="utf-8")
    for text in (said, page):
        assert "said 0" in text
        assert "said 199" in text
        assert "said 100" not in text
        assert SILENT in text
    assert "141 more in results.json" in page
    assert "the controller | silent for 9.1" in page
    report = json.loads((tmp_path / "page" / "happened" / "results.json").read_text())
    states, events = report["data"]["states"], report["data"]["events"]
    assert [one["start_s"] for one in states[:3]] == pytest.approx([0.0, 0.1, 0.2], abs=1e-3)
    assert states[-1]["end_s"] == pytest.approx(30.0, abs=1e-3)
    assert len(states) == 201
    assert events[-1]["time_s"] == pytest.approx(states[-1]["start_s"])


def test_the_states_that_are_drawn_have_names_and_colours(recording, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(overview, "save", lambda figure, _: drawn.append(figure))
    overview.overview(recording, [], (0.005,), tmp_path)
    pyplot().close(drawn[0])
    legend = drawn[0].axes[0].get_legend()
    assert {text.get_text() for text in legend.get_texts()} == {
        spell.what for spell in story.states(recording)
    }
    assert set(overview.STATES) == {*State.__members__, SILENT, story.ENDED}


# --- beginnings ---


def beginning_at(recording, start_s, keys):
    """The recording, of whose topics some begin so late, s."""
    series = {}
    for key, one in recording.series.items():
        kept = one.arrival_s - recording.start_s >= (start_s if key in keys else 0.0)
        series[key] = Series(one.topic, one.arrival_s[kept], one.stamp_s[kept], one.values[kept])
    return replace(recording, series=series)


def test_an_arm_that_moves_before_the_first_command_lacks_its_beginning(recording):
    assert story.moved_before_s(recording) == 0.0
    late = beginning_at(recording, GIVEN_S + 0.4, ["commands"])
    assert story.moved_before_s(late) == pytest.approx(0.4, abs=0.02)
    still = beginning_at(recording, GIVEN_S - 0.1, ["commands"])
    assert story.moved_before_s(still) == 0.0
    late.series["joints"].values[:, 6:] = np.nan
    assert story.moved_before_s(late) == pytest.approx(0.4, abs=0.03)


def test_the_page_says_that_the_beginning_is_missing(recording, tmp_path, undrawn):
    def paragraphs(one):
        return happened(one, runs.targets(one), (0.005, 0.002), tmp_path).setup

    assert len(paragraphs(recording)) == 1
    late = beginning_at(recording, GIVEN_S + 0.4, ["commands", "true_ball", "ball"])
    _, moved, first = paragraphs(late)
    assert "moved already 0.4" in moved
    assert "0.4" in first
    assert "its start distance is not known" in first


# --- predictions ---


def test_the_true_jacobian_predicts_without_error(recording):
    found = estimates.prediction(recording)
    assert found.true
    assert found.time_s.size > 10
    # What is left is the interpolation between ticks.
    assert found.t1_m.max() < 1e-4
    assert found.t2_m[-1] < 1e-3


def test_a_wrong_jacobian_is_off_by_its_share(tmp_path):
    made = HandmadeBag(tmp_path / "bag")
    servo(made)
    made.close()
    recording = read(tmp_path / "bag")
    recording.series["jacobian"].values[:] = 0.9 * JACOBIAN.reshape(-1)
    found = estimates.prediction(recording)
    assert found.share == pytest.approx(0.1, abs=0.005)
    assert found.t2_m[-1] == pytest.approx(0.1 * found.motion_m.sum(), rel=0.05)


def shifted(recording, keys, by_s):
    """The recording with the stamps of some series moved."""
    series = {
        key: replace(one, stamp_s=one.stamp_s + (by_s if key in keys else 0.0))
        for key, one in recording.series.items()
    }
    return replace(recording, series=series)


@pytest.mark.parametrize("by_s", [-100.0, 100.0])
def test_stamps_by_another_clock_change_no_prediction_and_are_named(recording, by_s):
    # Worse from tick to tick: another choice of Jacobian is another error.
    jacobian = recording.series["jacobian"]
    worse = np.linspace(1.0, 0.5, len(jacobian))[:, None] * jacobian.values
    series = {**recording.series, "jacobian": replace(jacobian, values=worse)}
    one_clock = replace(recording, series=series)
    other = shifted(one_clock, ("joints", "ball", "true_ball"), by_s)
    expected, found = estimates.prediction(one_clock), estimates.prediction(other)
    assert expected.t1_m.max() > 1e-4
    assert found.t1_m == pytest.approx(expected.t1_m, abs=1e-6)
    assert timing.other_clocks(one_clock) == ""
    side = "behind" if by_s < 0.0 else "ahead of"
    assert "/joint_states are" in timing.other_clocks(other)
    assert f"100.0 s {side} it" in timing.other_clocks(other)


def test_a_jacobian_that_came_after_the_image_predicts_nothing_of_it(recording):
    ball, jacobian = recording.series["ball"], recording.series["jacobian"]
    quick = replace(ball, arrival_s=ball.stamp_s - 0.03)
    time_s = estimates.prediction(recording).time_s[5]
    learned = jacobian.arrival_s > time_s - 0.03
    values = np.where(learned[:, None], 10.0, 1.0) * jacobian.values
    series = {**recording.series, "ball": quick, "jacobian": replace(jacobian, values=values)}
    found = estimates.prediction(replace(recording, series=series))
    assert found.time_s[5] == time_s
    assert found.t1_m[5] < 1e-4
    assert found.t1_m[6] > 1e-3


def test_without_a_jacobian_nothing_is_said_of_it(recording):
    series = {key: one for key, one in recording.series.items() if key != "jacobian"}
    assert estimates.prediction(replace(recording, series=series)) is None


# --- the page ---


def test_the_page_has_all_sections_and_the_numbers(bag, tmp_path, capsys):
    assert main(["replay", str(bag), "--out", str(tmp_path / "page")]) == 0
    said = capsys.readouterr().out
    assert "1.02 s" in said or "1.03 s" in said
    assert "no target_position yet" in said
    html = (tmp_path / "page" / "index.html").read_text(encoding="utf-8")
    for words in ("Recording run_1", "What happened", "Targets", "Timing", "Predictions"):
        assert words in html
    assert "Uncalibrated visual servoing, measured side by side" not in html
    results = json.loads((tmp_path / "page" / "targets" / "results.json").read_text())
    (target,) = results["data"]["targets"]
    assert target["given_s"] == pytest.approx(GIVEN_S, abs=0.01)
    for section, figure in (
        ("happened", "overview"),
        ("targets", "errors"),
        ("targets", "paths"),
        ("timing", "ages"),
        ("prediction", "estimates"),
    ):
        assert (tmp_path / "page" / section / f"{figure}.png").stat().st_size > 10_000
    text = (tmp_path / "page" / "index.md").read_text(encoding="utf-8")
    assert "![" in text
    assert "nan" not in text


def test_a_page_without_targets_says_what_is_missing(tmp_path, capsys):
    made = HandmadeBag(tmp_path / "bag")
    for tick in range(200):
        made.joints(0.008 * tick + 0.002, 0.008 * tick, np.zeros(6), np.zeros(6))
    made.close()
    assert main(["replay", str(tmp_path / "bag"), "--out", str(tmp_path / "page")]) == 0
    said = capsys.readouterr().out
    assert "Neither the true nor the measured position of the ball is in the bag." in said
    assert "status is not in the bag" in said


# --- bags of all kinds ---


def test_sqlite_bags_and_lone_files_are_read_alike(tmp_path):
    mcap, sqlite = (
        simple(tmp_path / plugin.name, plugin)
        for plugin in (StoragePlugin.MCAP, StoragePlugin.SQLITE3)
    )
    (file,) = mcap.glob("*.mcap")
    counts = [
        {topic: len(flow.arrival_s) for topic, flow in read(path).flows.items()}
        for path in (mcap, sqlite, file)
    ]
    assert counts[0] == counts[1] == counts[2]


@pytest.fixture(scope="module", params=[StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def noted(request, tmp_path_factory):
    """A folder whose notes change what a replay shows, and its file without what lies beside it."""
    folder = tmp_path_factory.mktemp("noted") / "bag"
    demo = {**DEMO, "fvs_demo_node": {"settle_error_m": 0.02, "target_s": 3.0}}
    made = HandmadeBag(folder, request.param, scenario=demo, remaps={"/target_position": "/goal"})
    servo(made, target="goal")
    made.close()
    (file,) = (one for one in folder.iterdir() if one.suffix in (".mcap", ".db3"))
    return folder, Path(shutil.copy(file, folder.parent))


def test_a_lone_file_notes_what_its_folder_does(noted):
    folder, file = map(read, noted)
    assert runs.settle_error_m(file) == 0.02
    assert (file.scenario, file.version) == (folder.scenario, folder.version)
    assert file.series["target"].topic == folder.series["target"].topic == "/goal"


def test_the_page_of_a_lone_file_is_that_of_its_folder(noted, tmp_path, undrawn):
    origin = Origin("", "", "", quick=False)
    folder, file = (
        [write_report(one, tmp_path, origin).read_text() for one in sections(read(path), tmp_path)]
        for path in noted
    )
    assert folder == file
    assert "to 20 mm" in str(folder)


# --- bags that were never finished ---


def killed(folder, whole, **notes):
    """What a recorder leaves that is killed when it has heard nearly all of another bag."""
    bag = Bag(folder, notes)
    with AnyReader([whole]) as reader:
        end_ns = reader.end_time - 300_000_000
        for connection, time_ns, raw in reader.messages(stop=end_ns):
            bag.write(Message(connection.topic, connection.msgtype, time_ns, raw))
    return folder


def is_beginning_of(one, other):
    """Whether a recording holds what another one does, up to some moment."""
    for topic, flow in one.flows.items():
        expected = other.flows[topic].arrival_s
        assert np.array_equal(flow.arrival_s, expected[: len(flow.arrival_s)])
        assert (expected[len(flow.arrival_s) :] >= one.end_s - 1e-9).all()
    return one.start_s == other.start_s


def test_a_bag_whose_recorder_was_killed_is_replayed(tmp_path, bag, recording, capsys):
    scenario = yaml.safe_dump({f"/{node}": {"ros__parameters": one} for node, one in DEMO.items()})
    folder = killed(tmp_path / "bag", bag, scenario=scenario, fvs_ros_version="1.2.3")
    (file,) = folder.glob("*.mcap")
    for path in (folder, file):
        found = read(path)
        assert found.cut_off
        assert is_beginning_of(found, recording)
        assert recording.end_s - 1.4 < found.end_s < recording.end_s - 0.3
        assert (found.scenario, found.version) == (recording.scenario, "1.2.3")
        (target,) = runs.targets(found)
        (whole,) = runs.targets(recording)
        assert target.score.settling_2mm_s == whole.score.settling_2mm_s
    assert not recording.cut_off
    assert main(["replay", str(folder), "--out", str(tmp_path / "page")]) == 0
    assert "The bag was cut off" in capsys.readouterr().out
    assert "The bag was cut off" in (tmp_path / "page" / "index.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("tail", [b"", bytes(5000)], ids=["short", "zeros"])
def test_a_file_that_ends_anywhere_is_read_as_far_as_it_is_whole(tmp_path, bag, recording, tail):
    (file,) = killed(tmp_path / "bag", bag).glob("*.mcap")
    content = file.read_bytes()
    ends_s = []
    for size in np.linspace(0.4 * len(content), len(content) - 1, 8).astype(int):
        file.write_bytes(content[:size] + tail)
        found = read(file)
        assert found.cut_off
        assert is_beginning_of(found, recording)
        ends_s.append(found.end_s)
    assert ends_s == sorted(ends_s)
    assert ends_s[-1] - ends_s[0] > 1.0
    for size in (8, 20, 100) if tail else (0, 5, 8, 20, 100):
        file.write_bytes(content[:size] + tail)
        with pytest.raises(BagError, match="cut off before any message"):
            read(file)


def test_a_whole_bag_that_was_not_copied_whole_is_read_with_its_notes(tmp_path, bag, recording):
    folder = shutil.copytree(bag, tmp_path / "bag")
    (file,) = folder.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:-20])  # all messages, but no index
    found = read(folder)
    assert found.cut_off
    assert found.end_s == recording.end_s
    assert found.scenario == recording.scenario


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_folder_without_metadata_is_read_by_its_files(tmp_path, storage):
    made = HandmadeBag(tmp_path / "bag", storage, scenario=DEMO)
    servo(made)
    made.close()
    whole = read(tmp_path / "bag")
    (tmp_path / "bag" / "metadata.yaml").unlink()
    found = read(tmp_path / "bag")
    assert is_beginning_of(found, whole)
    assert found.end_s == whole.end_s
    assert found.scenario == whole.scenario
    assert found.cut_off == (storage is StoragePlugin.SQLITE3)


def pieces(folder, names, begins_s, whole):
    """Files of one folder, each with what another bag holds from one moment to the next, s."""
    folder.mkdir()
    with AnyReader([whole]) as reader:
        moments_ns = [reader.start_time + round(1e9 * one) for one in begins_s]
        for name, start_ns, stop_ns in zip(
            names, moments_ns, [*moments_ns[1:], reader.end_time], strict=True
        ):
            bag = Bag(folder / "made", {})
            for connection, time_ns, raw in reader.messages(start=start_ns, stop=stop_ns):
                bag.write(Message(connection.topic, connection.msgtype, time_ns, raw))
            bag.close()
            (file,) = (folder / "made").glob("*.mcap")
            file.rename(folder / name)
            shutil.rmtree(folder / "made")
    return folder


def test_the_parts_of_a_split_bag_are_one_recording(tmp_path, bag, recording):
    names = [f"run_{number}.mcap" for number in range(11)]  # the tenth comes after the ninth
    folder = pieces(tmp_path / "bag", names, np.linspace(0.0, 4.5, 11), bag)
    found = read(folder)
    assert not found.cut_off
    assert (found.start_s, found.end_s) == (recording.start_s, recording.end_s)
    assert is_beginning_of(found, recording)
    last = folder / "run_10.mcap"
    last.write_bytes(last.read_bytes()[:-20])  # its recorder was killed then
    assert read(folder).cut_off
    assert is_beginning_of(read(folder), recording)
    (folder / "run_3.mcap").unlink()
    with pytest.raises(BagError, match="holds several bags"):
        read(folder)


@pytest.mark.parametrize(
    "names",
    [
        ("a.mcap", "b.mcap"),
        ("a_0.mcap", "b_1.mcap"),
        ("run_1.mcap", "run_2.mcap"),
        ("a.mcap", "a_0.mcap"),
    ],
)
@pytest.mark.parametrize("cut_off", [True, False])
def test_several_bags_in_one_folder_are_not_one(tmp_path, bag, recording, names, cut_off):
    folder = pieces(tmp_path / "bag", names, [0.0, 3.0], bag)
    if cut_off:
        (folder / names[0]).write_bytes((folder / names[0]).read_bytes()[:-20])
    with pytest.raises(BagError) as refused:
        read(folder)
    assert str(refused.value) == f"{folder} holds several bags, name one: {', '.join(names)}"
    assert read(folder / names[0]).start_s == recording.start_s


def test_bags_of_other_times_are_not_one_whatever_their_names(tmp_path, bag):
    folder = tmp_path / "bag"
    folder.mkdir()
    for number, later_s in enumerate((0.0, 60.0)):
        made = HandmadeBag(tmp_path / f"run_{number}")
        for step in range(10):
            made.array("jacobian", later_s + 0.1 * step, JACOBIAN)
        made.close()
        (file,) = (tmp_path / f"run_{number}").glob("*.mcap")
        file.rename(folder / f"run_{number}.mcap")
    with pytest.raises(BagError, match=r"several bags, name one: run_0\.mcap, run_1\.mcap"):
        read(folder)


def test_a_file_beside_a_bag_s_own_is_none_of_it(tmp_path, bag, recording):
    folder = shutil.copytree(bag, tmp_path / "bag")
    (own,) = folder.glob("*.mcap")
    content = own.read_bytes()
    (folder / "another.mcap").write_bytes(content[:-20])
    assert not read(folder).cut_off
    own.write_bytes(content[:-20])
    assert len(read(folder).series["ball"]) == len(recording.series["ball"])


def test_messages_in_disorder_and_without_chunks_are_put_in_order(tmp_path):
    writer = pytest.importorskip("mcap.writer")
    kind = "std_msgs/msg/Float64MultiArray"
    layout = TYPES.types["std_msgs/msg/MultiArrayLayout"]([], 0)
    raw = TYPES.serialize_cdr(TYPES.types[kind](layout, JACOBIAN.reshape(-1)), kind)
    with (tmp_path / "bag.mcap").open("wb") as file:
        made = writer.Writer(file, use_chunking=False)
        made.start(profile="ros2")
        definition, _ = TYPES.generate_msgdef(kind, ros_version=2)
        schema = made.register_schema(kind, "ros2msg", definition.encode())
        channel = made.register_channel("/jacobian", "cdr", schema)
        for time_s in (2, 1, 4, 3):
            made.add_message(channel, time_s * 10**9, raw, time_s * 10**9)
    found = read(tmp_path / "bag.mcap")  # as killed: never finished
    assert found.cut_off
    assert np.array_equal(found.series["jacobian"].arrival_s, [1.0, 2.0, 3.0, 4.0])


def test_what_is_missing_is_named_with_the_way_to_get_it(tmp_path, monkeypatch, capsys):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "jinja2" else find(name)
    )
    assert main(["replay", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert ".venv/bin/pip install -c constraints.txt -e '.[record,lab]'" in error
    assert "elsewhere, pip install jinja2\n" in error


def test_a_namespace_is_found_by_itself(tmp_path):
    recording = read(simple(tmp_path / "bag", namespace="/left"))
    assert recording.namespace == "left"
    assert len(runs.targets(recording)) == 1


def test_a_remapped_topic_is_found_by_its_other_name(tmp_path):
    remaps = {"/left/target_position": "/left/goal", "/left/ball_position": "/left/cam/jacobian"}
    made = HandmadeBag(tmp_path / "bag", namespace="/left", remaps=remaps)
    made.array("jacobian", 0.0, JACOBIAN)
    made.point("cam/jacobian", 0.1, 0.1, START_M)
    made.point("goal", 0.2, 0.2, TARGET_M)
    made.close()
    recording = read(tmp_path / "bag")
    assert recording.namespace == "left"
    assert recording.series["target"].topic == "/left/goal"
    assert np.array_equal(recording.series["target"].values, [TARGET_M])
    assert np.array_equal(recording.series["ball"].values, [START_M])


@pytest.mark.parametrize("text", ["[1, 2", "words", "- a", "3"])
def test_another_tool_s_note_on_remaps_is_passed_over(tmp_path, monkeypatch, text):
    monkeypatch.setattr(yaml, "safe_dump", lambda _: text)
    made = HandmadeBag(tmp_path / "bag", remaps={})
    made.point("target_position", 0.2, 0.2, TARGET_M)
    made.close()
    assert "target" in read(tmp_path / "bag").series


def two_robots(folder):
    made = HandmadeBag(folder)
    made.array("left/jacobian", 0.0, JACOBIAN)
    made.array("right/jacobian", 0.0, JACOBIAN)
    made.close()
    return folder


def nothing_left(folder):
    simple(folder)
    (file,) = folder.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:2000])
    return folder


def garbled(folder):
    simple(folder)
    (file,) = folder.glob("*.mcap")
    content = bytearray(file.read_bytes())
    content[2000:4000] = bytes(2000)
    file.write_bytes(bytes(content))
    return folder


def strange_metadata(folder):
    simple(folder)
    (folder / "metadata.yaml").write_text("[1, 2", encoding="utf-8")
    return folder


def unfolding_metadata(folder):
    simple(folder)
    rows = ["a0: &a0 [x, x]"]
    rows += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 7)]
    path = folder / "metadata.yaml"
    text = path.read_text().split("  custom_data:")[0]
    path.write_text("\n    ".join([f"{text}  custom_data:", *rows]))
    return folder


def unfolding_profiles(folder):
    simple(folder)
    path = folder / "metadata.yaml"
    content = yaml.safe_load(path.read_text())
    for topic in content["rosbag2_bagfile_information"]["topics_with_message_count"]:
        topic["topic_metadata"]["offered_qos_profiles"] = "- &a {depth: 1}\n- *a\n"
    path.write_text(yaml.safe_dump(content))
    return folder


def large_metadata(folder):
    simple(folder)
    with (folder / "metadata.yaml").open("r+b") as file:
        file.truncate(2**32)  # sparse: it takes no room on the disk
    return folder


def foreign(folder):
    made = HandmadeBag(folder)
    made.array("weather", 0.0, [1.0])
    made.close()
    return folder


def empty(folder):
    HandmadeBag(folder).close()
    return folder


def wrong_file(folder):
    folder.write_text("not a bag", encoding="utf-8")
    return folder


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda folder: folder, "there is no"),
        (lambda folder: folder.mkdir() or folder, "neither metadata.yaml nor an .mcap file"),
        (nothing_left, "cut off before any message"),
        (garbled, "cannot read"),
        (strange_metadata, "cannot read"),
        (unfolding_metadata, "aliases (*name) are not taken"),
        (unfolding_profiles, "aliases (*name) are not taken"),
        (large_metadata, "metadata.yaml is too large"),
        (wrong_file, "cannot read"),
        (foreign, "it has /weather"),
        (empty, "no messages"),
        (two_robots, "name one by --namespace: '/left', '/right'"),
    ],
)
def test_a_bag_that_cannot_be_looked_at_is_one_sentence(tmp_path, capsys, make, words):
    path = make(tmp_path / "thing")
    assert main(["replay", str(path), "--out", str(tmp_path / "page")]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_what_a_bag_unpacks_to_is_bounded():
    before = resource.getrlimit(resource.RLIMIT_DATA)
    with files.bounded_memory(), pytest.raises(MemoryError):
        np.zeros(2**30)
    assert resource.getrlimit(resource.RLIMIT_DATA) == before


@pytest.mark.parametrize("below", [False, True])
def test_a_page_cannot_be_written_to_a_file_and_that_is_said(tmp_path, bag, capsys, below):
    (tmp_path / "file").touch()
    out = tmp_path / "file" / "page" if below else tmp_path / "file"
    assert main(["replay", str(bag), "--out", str(out)]) == 2
    assert capsys.readouterr().err == (
        f"fvs_experiments replay: cannot write the page to {out}: it is no folder; "
        "name another folder by --out\n"
    )


def test_a_namespace_that_is_not_there_is_named(tmp_path):
    folder = two_robots(tmp_path / "bag")
    assert read(folder, "left").namespace == "left"
    with pytest.raises(BagError, match="'/left', '/right'"):
        read(folder, "middle")
