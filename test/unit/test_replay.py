"""What a replay says of recordings in which everything is known."""

import re
from pathlib import Path

import numpy as np
import pytest
from cases import each

pytest.importorskip("rosbags")

from replayed_bags import (
    DECAY_1_S,
    END_S,
    GIVEN_S,
    START_M,
    TARGET_M,
    array,
    distance_m,
    file_in,
    joints,
    message,
    point,
    pose,
    servo,
    status,
    write_bag,
)

from fvs_lab.main import main
from fvs_lab.replay import read, targets
from fvs_tools.bag import Bag

#: When the ball in the handmade bag comes below 5 and 2 mm, s after the target.
BELOW_5_S, BELOW_2_S = np.log(60) / DECAY_1_S, np.log(150) / DECAY_1_S


@pytest.fixture
def replayed(tmp_path, capsys):
    """Replays a bag; the lines of its table."""

    def replay(bag, *arguments):
        out = tmp_path / "out"
        assert main(["replay", str(bag), "--out", str(out), *arguments]) == 0
        assert (out / "replay.png").stat().st_size > 10_000
        return capsys.readouterr().out.splitlines()[1:-1]

    return replay


def without_statuses(messages):
    return [sent for sent in messages if sent.topic != "/fvs_controller_node/status"]


def targets_in(folder, messages, **notes):
    return targets(read(write_bag(folder, messages, **notes)))


# --- targets ---


def test_a_target_is_judged_by_the_true_ball(tmp_path, replayed):
    (row,) = replayed(write_bag(tmp_path / "bag", servo()))
    assert row.endswith(
        "300 mm     1.02 s     1.26 s    0.00 mm        2.40 rad/s  set at 1.0 s, SETTLED"
    )
    ((*_, score, _),) = targets(read(tmp_path / "bag"))
    assert BELOW_5_S <= score.settling_5mm_s < BELOW_5_S + 0.0081
    assert BELOW_2_S <= score.settling_2mm_s < BELOW_2_S + 0.0081


def test_a_repeated_target_is_the_same_a_new_one_another_and_a_moving_one_is_one(tmp_path):
    again = point("target_position", 1.7, GIVEN_S, TARGET_M)
    back = point("target_position", 3.0, None, START_M)  # by hand, without a stamp
    moving = [point("target_position", t, t, TARGET_M + 0.1 * t) for t in np.arange(4, 5, 0.05)]
    messages = [*without_statuses(servo()), again, back, *moving]
    first, second, third = targets_in(tmp_path / "bag", messages)
    assert first.time_s[-1] - first.set_s <= 2.0 + 1e-6
    assert second.set_s - first.set_s == pytest.approx(2.0)
    assert second.score.start_distance_m == pytest.approx(0.3, abs=0.001)
    assert second.score.settling_5mm_s is None
    assert third.errors_m[-1] == pytest.approx(np.linalg.norm([0.495] * 3), abs=0.01)


@pytest.mark.parametrize("passed_s", [0.0, 2.0], ids=["refused", "replaced by a service"])
def test_the_controller_s_status_shows_which_target_it_has(tmp_path, passed_s):
    shown = [
        status(t, "SERVOING", "SERVOING", TARGET_M if t < GIVEN_S + passed_s else START_M)
        for t in np.arange(GIVEN_S, END_S, 0.1)
    ]
    judged = targets_in(tmp_path / "bag", [*without_statuses(servo()), *shown])
    ends_s = [target.time_s[-1] - target.set_s for target in judged]
    assert ends_s == [pytest.approx(passed_s, abs=0.11)] * bool(passed_s)


@pytest.mark.parametrize(
    ("states", "reason", "end_s"),
    [
        ([("HOLDING", "STALE"), ("HOLDING", "NOT_FOLLOWING")], "NOT_FOLLOWING", 5.0),
        ([("SERVOING", "SETTLED"), ("READY", "READY")], "SETTLED", 3.0),
        ([("SERVOING", "SERVOING"), ("HOLDING", "SHUT_DOWN")], "SERVOING", 3.0),
        ([("WAITING", "MISSING"), ("WAITING", "MISSING")], "MISSING", 5.0),
    ],
)
def test_what_ended_a_target_is_said(tmp_path, states, reason, end_s):
    shown = [status(t, *states[int(t >= 3.0)], TARGET_M) for t in np.arange(GIVEN_S, END_S, 0.1)]
    (target,) = targets_in(tmp_path / "bag", [*without_statuses(servo()), *shown])
    assert target.reason == reason
    assert target.time_s[-1] - target.set_s == pytest.approx(end_s - GIVEN_S, abs=0.11)


def test_what_the_bag_lacks_is_not_judged(tmp_path, replayed):
    messages = [sent for sent in servo() if not re.search("ball|joint", sent.topic)]
    (row,) = replayed(write_bag(tmp_path / "bag", messages))
    assert re.fullmatch(r"\s*1\s+nan mm\s+never\s+never\s+nan mm\s+nan rad/s.*", row)


@pytest.mark.parametrize("noted", [True, False])
def test_poses_and_position_commands_are_judged_as_well(tmp_path, replayed, noted):
    messages = [pose("target_pose", GIVEN_S + 0.001, GIVEN_S, TARGET_M, 0.0)]
    for t in np.arange(0.0, END_S, 0.04):
        error_m = distance_m(t)
        messages += [
            joints(t, t, np.zeros(6)),
            array("forward_position_controller/commands", t, [error_m, 0, 0, 0, 0, error_m]),
            # The arc at 0.3 m is 0.4 of the way, so the way settles last.
            pose("tool_pose", t + 0.04, t, TARGET_M + [error_m, 0, 0], 0.4 * error_m / 0.3),
        ]
    parameters = {"feature": "pose", "lever_arm_m": 0.3, "command_interface": "position"}
    scenario = {"/**/fvs_controller_node": {"ros__parameters": parameters}}
    bag = write_bag(tmp_path / "bag", messages, **({"scenario": scenario} if noted else {}))
    assert len(replayed(bag)) == 1
    ((*_, score, _),) = targets(read(bag))
    assert score.start_distance_m == pytest.approx(0.3, rel=0.02)
    assert BELOW_5_S <= score.settling_5mm_s < BELOW_5_S + 0.041
    rest_rad = 0.4 * distance_m(END_S - 1.04) / 0.3 / np.sqrt(2.0 * DECAY_1_S)
    assert score.final_rms_deg == pytest.approx(np.degrees(rest_rad), rel=0.1)
    assert read(bag).series["positions"].values.shape[1] == 6


# --- bags of all kinds ---


def test_what_the_nodes_would_refuse_is_passed_over(tmp_path):
    commands = "forward_velocity_controller/commands"
    odd = [
        point("fvs_sim_node/true_ball_position", 2.0, 1.99, [np.nan, 0.0, 1.0]),
        point("target_position", 3.0, 2.99, [0.0, np.inf, 1.0]),
        array(commands, 2.0, [np.inf] * 6),
        array(commands, 2.0, np.ones(5)),
        joints(2.0, 1.99, np.full(6, np.nan)),
        message("target_position", "geometry_msgs/msg/Point", 1.0, 0.0, 0.0, 1.0),
        message("tool_pose", "std_msgs/msg/Float64", 1.0, 0.0),
    ]
    (clean,) = targets_in(tmp_path / "clean", servo())
    recording = read(write_bag(tmp_path / "odd", [*servo(), *odd]))
    assert [target.score for target in targets(recording)] == [clean.score]
    assert recording.series["velocities"].values.shape == (625, 6)


def test_arrivals_count_where_stamps_are_of_another_clock(tmp_path):
    (true,) = targets_in(tmp_path / "true", servo())
    later = [sent._replace(stamp_ns=sent.stamp_ns + 10**12) for sent in servo()]
    (target,) = targets_in(tmp_path / "later", later)
    assert target.score.settling_5mm_s == pytest.approx(true.score.settling_5mm_s, abs=0.05)
    assert target.reason == "SETTLED"


def test_a_robot_is_chosen_by_its_namespace(tmp_path, replayed, capsys):
    robots = [
        sent._replace(topic=f"/{robot}{sent.topic}")
        for sent in servo()
        for robot in ("left", "right")
    ]
    bag = write_bag(tmp_path / "bag", robots)
    assert main(["replay", str(bag)]) == 2
    assert "name one by --namespace: '/left', '/right'" in capsys.readouterr().err
    assert len(replayed(bag, "--namespace", "/left")) == 1


@each("tail", [b"", bytes(5000)])
def test_a_file_that_ends_anywhere_is_read_up_to_there(tmp_path_factory, capsys, tail):
    folder = tmp_path_factory.mktemp("bags")
    bag = Bag(folder / "bag", {})  # as a recorder leaves it that is killed
    for sent in sorted(servo(), key=lambda sent: sent.stamp_ns):
        bag.write(sent)
    file = file_in(folder / "bag")
    content = file.read_bytes()
    ends_s = []
    for share in (0.4, 0.7, 0.999):
        file.write_bytes(content[: int(share * len(content))] + tail)
        recording = read(file)
        assert recording.cut_off
        ends_s.append(recording.end_s)
    assert ends_s[0] + 1.0 < ends_s[1] < ends_s[2]
    assert main(["replay", str(file), "--out", str(folder / "out")]) == 0
    assert capsys.readouterr().out.startswith("The bag was cut off")
    file.write_bytes(content[:100] + tail)
    with pytest.raises(ValueError, match="cut off before any message"):
        read(file)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda folder: None, "there is no"),
        (Path.mkdir, "neither metadata.yaml nor an .mcap file"),
        (lambda folder: folder.write_text("not a bag"), "cannot read"),
        (lambda folder: write_bag(folder, []), "no messages"),
        (lambda folder: write_bag(folder, [], scenario=["of another tool"]), "damaged"),
    ],
)
def test_a_bag_that_cannot_be_read_is_one_sentence(tmp_path, capsys, make, words):
    make(tmp_path / "thing")
    assert main(["replay", str(tmp_path / "thing"), "--out", str(tmp_path / "page")]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
