"""What a replay says of recordings in which everything is known."""

import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

from replayed_bags import (
    DECAY_1_S,
    END_S,
    GIVEN_S,
    START_M,
    TARGET_M,
    distance_m,
    file_in,
    joints,
    point,
    pose,
    servo,
    status,
    write_bag,
)

from fvs_lab.main import main
from fvs_lab.replay import read
from fvs_tools.bag import Bag

#: When the ball in the handmade bag comes below 5 and 2 mm, s after the target.
BELOW_5_S, BELOW_2_S = np.log(60) / DECAY_1_S, np.log(150) / DECAY_1_S


@pytest.fixture
def replayed(tmp_path, capsys):
    """Replays a bag; the verdict and the rows of its table."""

    def replay(bag, *arguments):
        out = tmp_path / "out"
        assert main(["replay", str(bag), "--out", str(out), *arguments]) == 0
        assert (out / "replay.png").stat().st_size > 10_000
        verdict, _, *rows, _ = capsys.readouterr().out.splitlines()
        return verdict, rows

    return replay


def without_statuses(messages):
    return [sent for sent in messages if sent.topic != "/fvs_controller_node/status"]


def records_in(folder, messages):
    return read(write_bag(folder, messages))[0]


def ends_s(records):
    return [record.truths[-1][0] for record in records]


# --- targets ---


def test_a_target_is_judged_by_the_true_ball(tmp_path, replayed):
    verdict, (row,) = replayed(write_bag(tmp_path / "bag", servo()))
    assert verdict == "1 of 1 targets settled"
    assert row.endswith("300 mm   1.02 s   1.26 s    0.00 mm        2.40 rad/s  SETTLED")
    (record,), _, _ = read(tmp_path / "bag")
    assert BELOW_5_S <= record.score().settling_5mm_s < BELOW_5_S + 0.0081
    assert BELOW_2_S <= record.score().settling_2mm_s < BELOW_2_S + 0.0081


def test_a_repeated_target_is_the_same_and_a_new_one_another(tmp_path):
    again = point("target_position", 1.7, GIVEN_S, TARGET_M)
    back = point("target_position", 3.0, None, START_M)  # by hand, without a stamp
    moving = [point("target_position", t, t, TARGET_M + 0.1 * t) for t in np.arange(2.9, 3, 0.03)]
    messages = [*without_statuses(servo()), again, *moving, back]
    first, second = records_in(tmp_path / "bag", messages)
    assert ends_s([first]) == [pytest.approx(1.9, abs=0.01)]
    assert second.start_s - first.start_s == pytest.approx(2.0)
    assert second.score().start_distance_m == pytest.approx(0.3, abs=0.001)
    assert second.score().settling_5mm_s is None


@pytest.mark.parametrize(
    ("states", "reason", "end_s"),
    [
        ([("HOLDING", "STALE"), ("HOLDING", "NOT_FOLLOWING")], "NOT_FOLLOWING", 5.0),
        ([("SERVOING", "SETTLED"), ("READY", "READY")], "SETTLED", 3.0),
        ([("SERVOING", "SERVOING"), ("HOLDING", "SHUT_DOWN")], "SERVOING", 3.0),
    ],
)
def test_what_ended_a_target_is_said(tmp_path, states, reason, end_s):
    shown = [status(t, *states[int(t >= 3.0)], TARGET_M) for t in np.arange(GIVEN_S, END_S, 0.1)]
    (record,) = records_in(tmp_path / "bag", [*without_statuses(servo()), *shown])
    assert record.note == reason
    assert ends_s([record]) == [pytest.approx(end_s - GIVEN_S, abs=0.11)]


def test_a_target_that_the_controller_refused_or_replaced_is_not_judged_further(tmp_path):
    for passed_s in (0.0, 2.0):
        shown = [
            status(t, "SERVOING", "SERVOING", TARGET_M if t < GIVEN_S + passed_s else START_M)
            for t in np.arange(GIVEN_S, END_S, 0.1)
        ]
        bag = write_bag(tmp_path / f"{passed_s}", [*without_statuses(servo()), *shown])
        if passed_s:
            assert ends_s(read(bag)[0]) == [pytest.approx(passed_s, abs=0.11)]
        else:
            with pytest.raises(ValueError, match="no target in it was taken"):
                read(bag)


def test_poses_are_judged_as_well(tmp_path, replayed):
    messages = [pose("target_pose", GIVEN_S + 0.001, GIVEN_S, TARGET_M, 0.0)]
    for t in np.arange(0.0, END_S, 0.04):
        error_m = distance_m(t)
        messages += [
            joints(t, t, np.zeros(6)),
            # The arc at 0.3 m is 0.4 of the way, so the way settles last.
            pose("tool_pose", t + 0.04, t, TARGET_M + [error_m, 0, 0], 0.4 * error_m / 0.3),
        ]
    bag = write_bag(tmp_path / "bag", messages)
    assert len(replayed(bag)[1]) == 1
    score = read(bag)[0][0].score()
    assert score.start_distance_m == pytest.approx(0.3, rel=0.02)
    assert BELOW_5_S <= score.settling_5mm_s < BELOW_5_S + 0.041
    rest_rad = 0.4 * distance_m(END_S - 1.04) / 0.3 / np.sqrt(2.0 * DECAY_1_S)
    assert score.final_rms_deg == pytest.approx(np.degrees(rest_rad), rel=0.1)


# --- bags of all kinds ---


def test_what_the_nodes_would_refuse_is_passed_over(tmp_path):
    odd = [
        point("fvs_sim_node/true_ball_position", 2.0, 1.99, [np.nan, 0.0, 1.0]),
        point("target_position", 3.0, 2.99, [0.0, np.inf, 1.0]),
        joints(2.0, 1.99, np.full(6, np.nan)),
    ]
    (clean,) = records_in(tmp_path / "clean", servo())
    (record,) = records_in(tmp_path / "odd", [*servo(), *odd])
    assert record.score() == clean.score()


def test_without_joint_states_and_truth_the_measured_ball_is_judged(tmp_path, replayed):
    messages = [sent for sent in servo() if not re.search("true|joint", sent.topic)]
    _, (row,) = replayed(write_bag(tmp_path / "bag", messages))
    assert re.search(r"300 mm +1\.0\d s .* 0\.00 rad/s", row)


def test_arrivals_count_where_stamps_are_of_another_clock(tmp_path):
    (true,) = records_in(tmp_path / "true", servo())
    later = [sent._replace(stamp_ns=sent.stamp_ns + 10**12) for sent in servo()]
    (record,) = records_in(tmp_path / "later", later)
    assert record.score().settling_5mm_s == pytest.approx(true.score().settling_5mm_s, abs=0.05)
    assert record.note == "SETTLED"


def test_a_robot_is_chosen_by_its_namespace(tmp_path, replayed, capsys):
    robots = [
        sent._replace(topic=f"/{robot}{sent.topic}")
        for sent in servo()
        for robot in ("left", "right")
    ]
    bag = write_bag(tmp_path / "bag", robots)
    assert main(["replay", str(bag)]) == 2
    assert "--namespace names the nodes'); it has /left/" in capsys.readouterr().err
    assert len(replayed(bag, "--namespace", "/left")[1]) == 1


def test_a_file_that_ends_anywhere_is_read_up_to_there(tmp_path, capsys):
    bag = Bag(tmp_path / "bag", {})  # as a recorder leaves it that is killed
    for sent in sorted(servo(), key=lambda sent: sent.stamp_ns):
        bag.write(sent)
    file = file_in(tmp_path / "bag")
    content = file.read_bytes()
    ends = []
    for share, tail in ((0.6, b""), (0.8, bytes(5000)), (0.999, b"")):
        file.write_bytes(content[: int(share * len(content))] + tail)
        records, _, cut_off = read(file)
        assert cut_off
        ends += ends_s(records)
    assert ends[0] + 0.5 < ends[1] < ends[2]
    assert main(["replay", str(file), "--out", str(tmp_path / "out")]) == 0
    assert capsys.readouterr().out.startswith("The bag was cut off")
    file.write_bytes(content[:100])
    with pytest.raises(ValueError, match="cut off before any message"):
        read(file)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda folder: None, "there is no"),
        (Path.mkdir, "neither metadata.yaml nor an .mcap file"),
        (lambda folder: folder.write_text("not a bag"), "cannot read"),
        (lambda folder: write_bag(folder, []), "no messages"),
    ],
)
def test_a_bag_that_cannot_be_read_is_one_sentence(tmp_path, capsys, make, words):
    make(tmp_path / "thing")
    assert main(["replay", str(tmp_path / "thing"), "--out", str(tmp_path / "page")]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
