"""Every row of the safety table, as a story told to the supervisor."""

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

from fvs_controller_node.agreement import Verdict
from fvs_controller_node.base import ControlOutput
from fvs_controller_node.inbox import Inbox
from fvs_controller_node.reasons import Reason, State
from fvs_controller_node.supervisor import Command, Present, Supervisor, checked_output
from fvs_ros.following import Following

DT_S, LAG_S = 0.008, 0.03
FRAME = "camera_color_optical_frame"
JACOBIAN = np.eye(3, 6) * 0.5
TARGET = np.array([0.0, 0.0, 1.0])
INPUTS = {"joint_states", "feature", "jacobian"}
NAN = float("nan")

#: What the law wants unless a test says otherwise.
WANTED = np.array([0.5, -0.4, 0.3, 0.0, 0.1, -0.2])


class Cell:
    """A supervisor with all its inputs at 125 Hz, on its way; tests change what it gets."""

    def __init__(self) -> None:
        self.supervisor = Supervisor()
        self.inputs, self.goal = self.supervisor.inputs, self.supervisor.goal
        self.now_s, self.since_s = 100.0, 0.0
        self.commands: list[Command] = []
        self.joints, self.following = np.zeros(6), Following()
        self.heal()

    def heal(self) -> None:
        """Make everything as it should be."""
        self.talking = set(INPUTS)
        self.ball_at: Callable[[float], np.ndarray] = lambda _t: TARGET + [0.2, 0.0, 0.0]
        self.jacobian, self.wanted = JACOBIAN, WANTED
        self.answer: Callable[[], ControlOutput] = lambda: ControlOutput(
            self.wanted, np.zeros(3), np.ones(3)
        )
        self.follows: np.ndarray | float = 1.0
        self.verdict: Verdict | None = None
        self.located, self.asked = True, 0
        self.inputs.add_program_running(True)
        for _ in range(5):
            self.inputs.add_speed_scaling(self.now_s, 100.0)
        self.since_s = self.now_s

    @property
    def age_s(self) -> float:
        return self.now_s - self.since_s

    def propose(self, *_: object) -> ControlOutput:
        self.asked += 1
        return self.answer()

    def tick(self) -> Command:
        self.now_s += DT_S
        supervisor, now_s, ball = self.supervisor, self.now_s, self.ball_at(self.age_s)
        if "joint_states" in self.talking:
            self.inputs.add("joint_states", now_s, self.joints)
        if "feature" in self.talking:
            self.inputs.add("feature", now_s, ball)
        if "jacobian" in self.talking:
            self.inputs.add("jacobian", now_s, self.jacobian)
        before = supervisor.velocity_rad_s
        place, why, waits = ball if self.located else None, "clocks disagree", np.zeros(6)
        if supervisor.last.state is State.SERVOING:
            asked = self.inputs.speed_scaling * before
            self.following.add(now_s, now_s, asked, self.joints, LAG_S)
        else:
            self.following.restart()
        present = Present(
            self.joints, place, self.jacobian, waits, why, self.verdict, self.following.fault
        )
        finding, output = supervisor.permit(now_s, DT_S, present), None
        if finding is None:
            finding, output = checked_output(self.propose, before, 3)
        command = supervisor.release(now_s, DT_S, finding, output)
        self.commands.append(command)
        self.joints = self.joints + self.follows * DT_S * command.velocity_rad_s
        step = np.abs(command.velocity_rad_s - before).max()
        assert step <= 6.0 * DT_S + 1e-12 or at_rest(command)
        return command

    def run(self, seconds: float) -> Command:
        for _ in range(round(seconds / DT_S)):
            command = self.tick()
        return command

    def until(self, reason: Reason, at_most_s: float = 5.0) -> Command:
        for _ in range(round(at_most_s / DT_S)):
            command = self.tick()
            if command.state is not State.SERVOING:
                assert command.reason is reason
                return command
        raise AssertionError(f"still {command.state}: {command.text}")

    def start(self) -> bool:
        return self.supervisor.start(self.now_s)[0]

    def fastest(self, seconds: float = 0.5) -> float:
        return float(np.abs(self.run(seconds).velocity_rad_s).max())


def at_rest(command: Command) -> bool:
    return not command.velocity_rad_s.any()


def servoing() -> Cell:
    cell = Cell()
    assert cell.goal.set(TARGET, FRAME)[0]
    assert cell.run(0.1).state is State.READY
    assert cell.start()
    np.testing.assert_allclose(cell.run(0.2).velocity_rad_s, WANTED)
    cell.since_s = cell.now_s
    return cell


# ---- what forbids motion --------------------------------------------------------------------


def ball(error_m: Callable[[float], float]) -> Callable[[Cell], None]:
    """An error along one axis, with noise, over time."""
    rng = np.random.default_rng(0)
    return lambda c: vars(c).update(
        ball_at=lambda t: TARGET + [error_m(t), 0.0, 0.0] + 0.001 * rng.normal(size=3)
    )


def changed(**values: object) -> Callable[[Cell], None]:
    return lambda c: vars(c).update(values)


def _fail() -> ControlOutput:
    raise np.linalg.LinAlgError("Singular matrix")


def singular(smallest: float) -> np.ndarray:
    return np.diag([0.5, 0.4, smallest, 0.0, 0.0, 0.0])[:3]


class Row(NamedTuple):
    """A trouble: when it stops the arm, why, whether by a ramp or zeros, and how it goes on."""

    cause: Callable[[Cell], object]
    within_s: tuple[float, float]
    reason: Reason
    words: str
    stop: str = "ramp"
    goes_on: str = "after a start"


AT_ONCE, HEALS = (0.0, 0.01), ("ramp", "by itself")
SLACK = np.array([1.0, 1.0, 0.0, 1.0, 1.0, 1.0])
WRONG, FROZEN = Verdict(0.02, 1.0, 1.5, 0.3), Verdict(0.013, 0.2, 0.7, 0.4)


def stale(name: str, limit_s: float) -> Row:
    within_s = (limit_s, limit_s + 0.02)
    return Row(changed(talking=INPUTS - {name}), within_s, Reason.STALE, "s old", *HEALS)


def bad(message: Callable[[Inbox], object]) -> Row:
    """A message that cannot be used, and silence."""

    def cause(cell: Cell) -> None:
        message(cell.inputs)
        cell.talking.clear()

    return Row(cause, AT_ONCE, Reason.BAD_INPUT, "not usable", "zeros", "by itself")


def law(answer: Callable[[], object], words: str) -> Row:
    return Row(changed(answer=answer), AT_ONCE, Reason.LAW_FAULT, words, "zeros")


def paused(pause: Callable[[Cell], None], reason: Reason) -> Row:
    return Row(pause, AT_ONCE, reason, "~/start", "zeros")


def lame(follows: object, within_s: tuple[float, float], joint: str) -> Row:
    return Row(changed(follows=follows), within_s, Reason.NOT_FOLLOWING, joint)


ROWS = {
    "joints stale": stale("joint_states", 0.1),
    "ball stale": stale("feature", 0.2),
    "jacobian stale": stale("jacobian", 0.2),
    "joints nan": bad(lambda inbox: inbox.add("joint_states", 0.0, np.full(6, NAN))),
    "ball in mm": bad(lambda inbox: inbox.add("feature", 0.0, 200.0 * TARGET)),
    "jacobian nan": bad(lambda inbox: inbox.add("jacobian", 0.0, NAN * JACOBIAN)),
    "scaling nan": bad(lambda inbox: inbox.add_speed_scaling(0.0, NAN)),
    "no position": Row(changed(located=False), AT_ONCE, Reason.NO_POSITION, "disagree", *HEALS),
    "singular": Row(
        changed(jacobian=singular(0.02)), AT_ONCE, Reason.NEAR_SINGULAR, "0.0200", *HEALS
    ),
    "velocity nan": law(lambda: ControlOutput.plain(NAN * WANTED, 3), "velocity"),
    "exponent short": law(lambda: ControlOutput(WANTED, TARGET, np.ones(1)), "exponent"),
    "no answer": law(lambda: None, "invalid command"),
    "exception": law(_fail, "Singular matrix"),
    "program stops": paused(lambda c: c.inputs.add_program_running(False), Reason.PROGRAM_STOPPED),
    "slider at zero": paused(
        lambda c: c.inputs.add_speed_scaling(c.now_s, 0.0), Reason.SPEED_SCALING_ZERO
    ),
    "conflict": Row(
        lambda c: c.inputs.conflicting_command(c.now_s, "/another_node"),
        AT_ONCE,
        Reason.CONFLICT,
        "/another_node commands the arm as well",
    ),
    "an image that does not follow": Row(
        changed(verdict=FROZEN),
        AT_ONCE,
        Reason.IMAGE_NOT_FOLLOWING,
        "the image does not follow the arm: 13 mm",
    ),
    "wrong jacobian": Row(changed(verdict=WRONG), (0.1, 0.6), Reason.PREDICTION_ERROR, "1.50"),
    # Half as much again takes 0.67 s, being seen for 1 s comes on top.
    "error grows": Row(
        ball(lambda t: 0.2 + 0.15 * t), (1.5, 2.1), Reason.ERROR_GROWING, "has grown"
    ),
    "no progress": Row(
        ball(lambda t: 0.05 + 0.15 * math.exp(-t)), (8.0, 14.0), Reason.STALLED, "50 mm"
    ),
    "oscillation": Row(
        ball(lambda t: 0.025 * math.cos(2.0 * math.pi * t)), (0.0, 30.0), Reason.OSCILLATING, ""
    ),
    # At 0.5 and 0.3 rad/s, 30 to 55 mrad beyond the lag.
    "arm stuck": lame(0.0, (0.06, 0.14), "shoulder_pan_joint"),
    "arm inverted": lame(-1.0, (0.06, 0.14), "does not follow: commanded"),
    "joint stuck": lame(SLACK, (0.1, 0.2), "elbow_joint"),
}


@pytest.mark.parametrize("row", ROWS.values(), ids=ROWS)
def test_what_forbids_motion_stops_the_arm_and_says_why(row: Row):
    cell = servoing()
    cell.heal()
    row.cause(cell)
    began_s = cell.now_s
    command = cell.until(row.reason, 31.0)
    assert row.within_s[0] <= cell.now_s - began_s - 1e-9 <= row.within_s[1] + DT_S
    fault = row.reason in (Reason.BAD_INPUT, Reason.LAW_FAULT)
    assert command.state is (State.FAULT if fault else State.HOLDING)
    assert row.words in command.text
    assert at_rest(command) is (row.stop == "zeros")
    cell.run(0.3)
    cell.asked = 0
    paused = row.reason in (Reason.PROGRAM_STOPPED, Reason.SPEED_SCALING_ZERO)
    if paused or row.reason is Reason.CONFLICT:  # they last
        assert not cell.start()
    assert cell.run(1.0).reason is row.reason
    cell.heal()
    if row.goes_on == "by itself":
        states = [cell.tick().state for _ in range(6)]
        assert states[4:] == [State.SERVOING] * 2
        if row.reason in (Reason.STALE, Reason.BAD_INPUT):  # five good messages
            assert State.SERVOING not in states[:4]
        return
    command = cell.run(1.0)
    assert command.reason is row.reason
    assert at_rest(command)
    assert not cell.asked
    assert "~/start" in command.text
    assert cell.start()
    assert cell.run(0.2).state is State.SERVOING


@pytest.mark.parametrize(("period_s", "allowed_s"), [(0.1, 0.25), (0.033, 0.2), (0.22, 0.5)])
def test_a_slow_camera_may_lose_an_image_and_a_quick_one_is_late_as_ever(period_s, allowed_s):
    cell = Cell()
    times_s = cell.now_s + period_s * np.arange(1, 12)
    for now_s in times_s[[0, 1, 2, 3, 4, 5, 6, 7, 8, 10]]:
        cell.inputs.add("feature", now_s, TARGET)
    ball = cell.inputs["feature"]
    assert ball.find(times_s[-1] + allowed_s - 0.001) is None
    late = ball.find(times_s[-1] + allowed_s + 0.001)
    assert late.reason is Reason.STALE
    wanted = "ball_max_age_s" if period_s < 0.08 else "2.5 of its periods"
    assert f"({wanted} is {allowed_s:.2f} s)" in late.text


# ---- before a start, and after the end --------------------------------------------------------


@pytest.mark.parametrize("missing", [*sorted(INPUTS), "target_position"])
def test_it_waits_for_every_input_and_for_a_start_and_starts_softly(missing: str):
    cell = Cell()
    if missing != "target_position":
        cell.goal.set(TARGET, FRAME)
    cell.talking -= {missing}
    command = cell.run(0.5)
    assert command.state is State.WAITING
    name = cell.inputs[missing].name if missing in INPUTS else missing
    assert f"no {name} yet" in command.text
    started, why = cell.supervisor.start(cell.now_s)
    assert not started
    assert name in why
    cell.heal()
    cell.goal.set(TARGET, FRAME)
    assert cell.run(0.1).state is State.READY
    assert cell.asked == 0
    assert all(at_rest(one) for one in cell.commands)
    assert cell.start()
    first = cell.tick()
    assert np.abs(first.velocity_rad_s).max() == pytest.approx(6.0 * DT_S, 1e-3)
    assert "acceleration" in first.active_limit
    assert cell.start()  # again: nothing changes
    np.testing.assert_allclose(cell.run(0.2).velocity_rad_s, WANTED)


@pytest.mark.parametrize("jerk", [0.0, 100.0])
def test_a_shutdown_is_at_once_or_within_the_limits_of_jerk_and_acceleration(jerk):
    cell = servoing()
    config = dataclasses.replace(cell.supervisor.config, max_joint_jerk_rad_s3=jerk)
    cell.supervisor.configure(config)
    command = cell.supervisor.shutdown()
    assert command.reason is Reason.SHUT_DOWN
    assert at_rest(command) is not jerk
    assert not cell.start()
    moved = [one.velocity_rad_s for one in cell.commands[-2:]]
    cell.talking.clear()  # nor does a joint state come
    moved += [cell.tick().velocity_rad_s for _ in range(30)]
    assert not jerk or np.abs(np.diff(moved, 2, axis=0)).max() <= jerk * DT_S**2
    assert np.abs(moved[20]).max() < 1e-3
    assert not moved[-1].any()


def test_a_gap_that_no_tick_saw_counts_too():
    cell = servoing()
    cell.now_s += 0.5  # the process was stopped; then all messages come at once
    assert cell.tick().state is State.HOLDING
    assert cell.run(0.1).state is State.SERVOING


# ---- targets ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("point", "frame", "words"),
    [
        ([1.5, 0.0, 1.0], FRAME, ["1.500 m", "[-1, 1]"]),
        ([0.0, -2.0, 9.0], FRAME, ["-2.000 m", "9.000 m"]),
        ([0.0, NAN, 1.0], FRAME, ["finite"]),
        ([0.0, 1.0], FRAME, ["3 finite"]),
        ([0.0, 0.0, 1.0], "world", ["world", FRAME]),
        ([0.0, 0.0, 1.0], "", ["frame_id", FRAME]),
    ],
)
def test_a_wrong_target_is_refused_and_the_old_one_stays(point, frame, words):
    cell = servoing()
    accepted, why = cell.goal.set(np.array(point), frame)
    assert not accepted
    assert all(word in why for word in words)
    np.testing.assert_array_equal(cell.goal.target, TARGET)
    assert cell.tick().state is State.SERVOING


def test_settled_means_near_for_a_while_and_the_status_gives_numbers():
    cell = servoing()
    fresh = Supervisor().status_values(0.0)
    values = cell.supervisor.status_values(cell.now_s)
    assert list(values) == list(fresh)
    assert (fresh["state"], values["state"]) == ("WAITING", "SERVOING")
    assert fresh["joint_states_age_s"] == math.inf
    assert values["error_m"] == pytest.approx(0.2)
    assert values["smallest_singular_value_m_rad"] == pytest.approx(0.5)
    assert values["target_z_m"] == 1.0
    for off_m, seconds, reason in (
        (4e-3, 0.3, "SERVOING"),
        (4e-3, 0.7, "SETTLED"),
        (0.02, 0.1, "SERVOING"),
    ):
        cell.ball_at = lambda _t, off_m=off_m: TARGET + [off_m, 0.0, 0.0]
        assert cell.run(seconds).reason is Reason[reason]


# ---- how fast -----------------------------------------------------------------------------------


def test_near_a_singularity_it_slows_down_and_a_hold_has_hysteresis():
    cell = servoing()
    cell.wanted, speeds = 10.0 * WANTED, []
    for smallest in (0.2, 0.07, 0.055, 0.04):
        cell.jacobian = singular(smallest)
        speeds.append(cell.fastest())
    assert speeds == sorted(speeds, reverse=True)
    assert speeds[::2] == pytest.approx([1.0, 0.5], 1e-3)
    assert "near singular (0.040 m/rad)" in cell.commands[-1].active_limit
    for smallest, state in ((0.02, "HOLDING"), (0.035, "HOLDING"), (0.07, "SERVOING")):
        cell.jacobian = singular(smallest)
        assert cell.run(0.5).state is State[state]


def held_near_a_singularity(smallest: float = 0.02) -> Cell:
    cell = servoing()
    cell.jacobian = singular(smallest)
    assert at_rest(cell.run(0.5))
    return cell


def test_a_new_start_leaves_a_singular_pose_slowly_not_nearer_to_it_and_for_ten_seconds():
    cell = held_near_a_singularity()
    assert "slowly" in cell.supervisor.start(cell.now_s)[1]
    assert cell.fastest() == pytest.approx(0.1, 1e-3)
    ball(lambda t: 0.2 * math.exp(-0.2 * t))(cell)
    assert cell.run(9.0).state is State.SERVOING
    cell.until(Reason.NEAR_SINGULAR, 1.0)
    assert cell.start()
    cell.jacobian = singular(0.012)
    cell.until(Reason.NEAR_SINGULAR)
    assert not cell.start()
    cell.jacobian = singular(0.3)
    assert cell.fastest() == pytest.approx(0.5)
    hopeless = held_near_a_singularity(0.002)
    assert "too singular to leave" in hopeless.supervisor.start(hopeless.now_s)[1]
    assert at_rest(hopeless.run(1.0))


@pytest.mark.parametrize("speed", [0.5, 5.0])
def test_a_wrong_jacobian_slows_the_arm_down_and_may_mislead_it_by_50_mm(speed: float):
    cell = servoing()
    cell.wanted = speed * WANTED
    free = cell.fastest()
    cell.verdict = Verdict(0.02, 1.0, 1.0, 0.3)
    assert cell.fastest() == pytest.approx(min(free, 0.5), 1e-3)
    cell.verdict = Verdict(0.02, 1.0, 1.5, 0.3)
    for _ in range(2):  # and as far again, on request
        way_m = 0.0
        while cell.tick().state is State.SERVOING:
            way_m += DT_S * np.linalg.norm(JACOBIAN @ cell.supervisor.velocity_rad_s)
        assert way_m == pytest.approx(0.05, rel=0.1)
        assert at_rest(cell.run(0.3))
        assert cell.start()


# ---- what is no trouble, and what hides none ----------------------------------------------------

NEARING = ball(lambda t: 0.2 * math.exp(-0.1 * t))
HARMLESS = {
    "arrives": ball(lambda t: 0.2 * math.exp(-3.0 * t)),
    "detour": ball(lambda t: 0.2 if t < 1.0 else 0.3 if t < 1.8 else 0.2 * math.exp(1.8 - t)),
    "noise": ball(lambda t: 0.004 * math.cos(2.0 * math.pi * t / 0.3)),
    "slow sway": ball(lambda t: 0.01 * math.cos(2.0 * math.pi * t / 8.0)),
    "one overshoot": ball(lambda t: 0.1 * math.cos(2.0 * math.pi * t) if t < 0.7 else 0.0),
    "half seen": lambda c: (NEARING(c), changed(verdict=Verdict(0.02, 0.5, 0.7, 0.4))(c)),
    **{
        f"follows by {share} at {percent} %": lambda c, share=share, percent=percent: (
            NEARING(c),
            changed(follows=share)(c),
            c.inputs.add_speed_scaling(c.now_s, percent),
        )
        for share, percent in ((0.25, 100.0), (0.3, 30.0), (0.03, 3.0), (0.25, 1000.0))
    },
}


@pytest.mark.parametrize("what", HARMLESS)
def test_what_is_no_trouble_does_not_stop_the_arm(what: str):
    cell = servoing()
    HARMLESS[what](cell)
    cell.run(8.0)
    assert {one.state for one in cell.commands[40:]} == {State.SERVOING}


@pytest.mark.parametrize(("every_s", "gaps"), [(0.25, False), (0.9, False), (1.1, True)])
def test_neither_noisy_targets_nor_gaps_in_an_input_hide_an_error_that_grows(every_s, gaps):
    cell, rng = servoing(), np.random.default_rng(1)
    set_s, error_m = cell.now_s, 0.2
    command = cell.commands[-1]
    while command.reason is not Reason.ERROR_GROWING:
        if cell.now_s - set_s >= every_s:
            set_s = cell.now_s
            if gaps:
                cell.talking -= {"feature"}
                cell.run(0.3)
                cell.talking = set(INPUTS)
            else:
                assert cell.goal.set(TARGET + 0.001 * rng.normal(size=3), FRAME)[0]
        error_m += 0.1 * DT_S
        cell.ball_at = lambda _t, error_m=error_m: TARGET + [error_m, 0.0, 0.0]
        command = cell.tick()
        assert error_m < 0.7
