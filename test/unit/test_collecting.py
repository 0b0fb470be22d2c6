"""Whatever a collection run meets: commands within limits, none unasked, and reasons in words."""

import math
from dataclasses import replace

import numpy as np
import pytest
from cases import each

from fvs_estimator_node.collecting import GIVE_UP_S, CollectionRun, CollectorConfig, State
from fvs_estimator_node.files import data_set_of
from fvs_estimator_node.motion import MotionConfig, RandomMotion
from fvs_ros.joints import UR_POSITION_LIMITS_RAD
from fvs_ros.kinds.points import Points
from fvs_ros.limits import with_urdf_limits
from fvs_ros.paths import find_file
from fvs_ros.urdf import read_joints
from fvs_tools.kinematics import kinematics

HOME = np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0])
DT_S, LONGEST_S, DURATION_S = 0.008, 0.05, 20.0
#: Within this time a command that is held takes no joint beyond its range, s.
HELD_S = 0.6
WILD = (100.0, -100.0, 5e-324, 0.0, -7.0)  # the most that a message may hold
MOVES = (State.MOVING, State.RETURNING)


class Cell:
    """A collection run, an arm that goes as ``signs`` say, and the promises of every tick."""

    def __init__(self, duration_s=DURATION_S, velocity=0.65, acceleration=3.0, signs=1.0):
        config = CollectorConfig(
            duration_s=duration_s,
            joint_range_rad=(0.3,) * 6,
            max_joint_velocity_rad_s=velocity,
            max_joint_acceleration_rad_s2=acceleration,
        )
        self.velocity, self.acceleration, self.signs = velocity, acceleration, signs
        self.run = CollectionRun(config)
        self.now_s = self.stamp_s = self.ticked_s = 5.0
        self.joints, self.last = HOME.copy(), np.zeros(6)
        self.measured = HOME
        self.beats, self.joints_come, self.ball_seen = 0, True, True
        self.joints_s = self.ball_s = -math.inf
        self.newest = {"joints": -math.inf, "ball": -math.inf}

    def tick(self, dt_s):
        before = self.run.state
        command = self.run.tick(self.now_s, dt_s)
        assert np.abs(command).max() <= self.velocity + 1e-12  # false for NaN, too
        dt_s = min(dt_s, LONGEST_S) if math.isfinite(dt_s) and dt_s > 1e-6 else 0.0
        steady_s = min(max(self.now_s - self.ticked_s, 0.0), LONGEST_S)
        self.ticked_s = self.now_s
        # A stop takes half a second at most; one that may be near the end of its range, none.
        most = max(self.acceleration, 2.0 * self.velocity) * (dt_s or steady_s) + 1e-12
        gone_s = HELD_S + self.now_s - self.joints_s
        ends = np.array(UR_POSITION_LIMITS_RAD) - gone_s * self.velocity
        slower = (np.abs(self.measured) > ends) & (np.abs(command) <= np.abs(self.last))
        assert np.all(slower | (np.abs(command - self.last) <= most))
        if self.run.state not in MOVES:
            assert np.all(np.abs(command) <= np.abs(self.last))
        else:
            assert self.now_s - self.joints_s <= 0.1
        if math.isinf(min(self.joints_s, self.ball_s)):
            assert not command.any()
        assert self.run.state is before or before not in (State.DONE, State.FAILED)
        assert self.run.reason
        assert 0.0 <= self.run.progress <= 1.0
        self.last = command
        self.joints = self.joints + self.signs * command * (dt_s or steady_s)

    def is_news(self, name, stamp_s):
        fresh = stamp_s > self.newest[name] or stamp_s < self.newest[name] - 0.1
        self.newest[name] = stamp_s if fresh else self.newest[name]
        return fresh

    def take_joints(self, joints, stamp_s):
        self.joints_s = self.now_s if self.is_news("joints", stamp_s) else self.joints_s
        self.run.joint_states(self.now_s, stamp_s, joints)
        self.measured = joints

    def take_ball(self, ball, stamp_s):
        self.ball_s = self.now_s if self.is_news("ball", stamp_s) else self.ball_s
        self.run.image(self.now_s, stamp_s, ball)

    def pass_time(self, joints=True, ball=True, steady_s=DT_S, stamp_s=DT_S, dt_s=None):
        self.beats += 1
        self.now_s += steady_s
        self.stamp_s += stamp_s
        if joints:
            self.take_joints(self.joints.copy(), self.stamp_s)
        if ball and self.beats % 4 == 0:
            self.take_ball(np.array([0.1, 0.2, 1.4]) + 0.3 * self.joints[:3], self.stamp_s - 0.04)
        self.tick(steady_s if dt_s is None else dt_s)

    def advance(self, seconds):
        for _ in range(round(seconds / DT_S)):
            self.pass_time(self.joints_come, self.ball_seen)
        return self.run.state

    def happen(self, scene, ticks, rng):
        """A scene of wild input."""
        if scene == "jump":
            self.stamp_s += float(rng.choice([-100.0, -0.5, -0.05, 0.5, 100.0]))
            self.now_s += float(rng.choice([0.0, 0.2, 5.0, 15.0]))
        elif scene == "fail":
            self.run.fail("enough")
        for _ in range(ticks):
            if scene == "wild joints" and rng.random() < 0.3:
                joints = self.joints.copy()
                joints[rng.integers(6)] = rng.choice(WILD)
                self.stamp_s += 1e-4
                self.take_joints(joints, self.stamp_s)
            elif scene == "wild ball" and rng.random() < 0.3:
                self.take_ball(rng.choice(WILD, 3), self.stamp_s + 1e-4)
            dt_s = float(rng.choice([-1.0, 0.0, 1e-300, 10.0, math.inf, math.nan]))
            self.pass_time(**{"odd dt": {"dt_s": dt_s}, **SCENES}.get(scene, {}))


SCENES = {
    "no joints": {"joints": False},
    "no ball": {"ball": False},
    "frozen": {"stamp_s": 0.0},
    "stalled": {"steady_s": 0.0},
    "still": {"dt_s": 0.0},
    "late": {"steady_s": 0.09, "stamp_s": 0.09},
}
ALL = ["good", "good", *SCENES, "jump", "wild joints", "wild ball", "fail", "odd dt"]


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of numpy, about wild numbers
@each("seed", range(40))
def test_no_sequence_breaks_a_promise(seed):
    rng = np.random.default_rng(seed)
    signs = rng.choice([1.0, 1.0, 0.0, -1.0])
    cell = Cell(30.0, rng.uniform(0.3, 3.0), rng.uniform(0.5, 40.0), signs)
    cell.happen("good", 60, rng)
    for scene in rng.choice(ALL, 8):
        cell.happen(scene, rng.integers(1, 50), rng)


@each(("source", "state"), [("joints_come", State.HOLDING), ("ball_seen", State.RETURNING)])
def test_lost_input_stops_or_turns_the_arm_until_it_is_back_or_ends_the_run(source, state):
    cell = Cell()
    cell.advance(5.0)
    away = np.abs(cell.joints - HOME).max()
    setattr(cell, source, False)
    assert cell.advance(2.0) is state
    assert state is State.HOLDING or np.abs(cell.joints - HOME).max() < 0.5 * away
    setattr(cell, source, True)
    assert cell.advance(1.0) is State.MOVING
    setattr(cell, source, False)
    assert cell.advance(GIVE_UP_S + 2.0) is State.FAILED
    assert cell.run.ended
    assert "gave up" in cell.run.reason
    assert not np.any(cell.last)


@each(("period", "late_s", "words"), [(125, 0.04, "at 1.0 Hz"), (4, 0.6, "stamped 0.6")])
def test_images_that_give_no_model_are_named_within_ten_seconds(period, late_s, words):
    cell = Cell()
    for tick in range(round(10.0 / DT_S)):
        cell.pass_time(ball=False)
        if tick % period == 0:
            cell.take_ball(np.array([0.1, 0.2, 1.4]) + 0.3 * cell.joints[:3], cell.stamp_s - late_s)
    assert words in cell.run.reason
    assert cell.run.reason.endswith(cell.run.image_trouble)


def test_a_camera_that_sees_nothing_turns_the_arm_only_with_all_others():
    run = CollectionRun(
        CollectorConfig(duration_s=60.0, feature="points", points=Points(cameras=("left", "right")))
    )
    joints, now_s = HOME, 5.0

    def advance(seconds, *cameras):
        nonlocal joints, now_s
        for tick in range(round(seconds / DT_S)):
            now_s += DT_S
            run.joint_states(now_s, now_s, joints)
            for camera in cameras if tick % 4 == 0 else ():
                run.image(now_s, now_s, 300.0 + 50.0 * joints[:2], camera)
            joints = joints + DT_S * run.tick(now_s, DT_S)
        return run.state

    assert advance(2.0, 0) is State.WAITING
    assert run.reason == "no right/image_points (none so far)"
    assert not np.any(joints - HOME)
    assert advance(3.0, 0, 1) is State.MOVING
    assert advance(3.0, 1) is State.MOVING
    assert "; no left/image_points (last 3.0 s ago)" in run.reason
    assert advance(1.0) is State.RETURNING
    for name in ("left", "right"):
        assert f"no {name}/image_points" in run.reason
    assert advance(2.0, 0) is State.MOVING
    data = data_set_of(*run.samples, cameras=("left", "right"), feature="points")
    left, right = data.parts
    assert [len(part) for part in data.parts] == [len(samples) for samples in run.samples]
    assert len(left.runs()) == 2
    assert len(right.runs()) == 1
    assert [part.cameras for part in data.parts] == [("left",), ("right",)]


@each(
    ("joint", "sign", "words"),
    [(3, -1.0, "wrist_1_joint moves against its command"), (slice(6), 0.0, "does not follow")],
)
def test_an_arm_that_does_not_follow_ends_the_run_before_it_gets_far(joint, sign, words):
    signs = np.ones(6)
    signs[joint] = sign
    cell = Cell(signs=signs)
    assert cell.advance(10.0) is State.FAILED
    assert words in cell.run.reason
    assert np.abs(cell.joints - HOME)[joint].max() < 0.1
    assert cell.run.ended


@each("state", [State.MOVING, State.RETURNING, State.HOLDING])
def test_a_joint_outside_its_box_ends_the_run_at_once(state):
    cell = Cell()
    cell.advance(5.0)
    cell.ball_seen = state is not State.RETURNING
    cell.joints_come = state is not State.HOLDING
    assert cell.advance(0.7) is state
    cell.joints_come = True
    # As far as a stall of the computer at full speed, and braking after it, take the joint.
    cell.joints[2] = HOME[2] + 0.3 + 0.46
    assert cell.advance(DT_S) is not State.FAILED
    cell.joints[2] = HOME[2] + 0.3 + 0.47
    assert cell.advance(DT_S) is State.FAILED
    assert "elbow_joint left its box" in cell.run.reason
    cell.advance(1.0)
    assert cell.run.ended


SLIDE = """<robot><joint name="turn" type="revolute"><parent link="a"/><child link="b"/>
<limit lower="-2.4" upper="2.4" velocity="4"/></joint><joint name="slide" type="prismatic">
<parent link="b"/><child link="c"/><limit lower="0.01" upper="0.19" velocity="0.5"/></joint>
</robot>"""


def sliding_arm():
    config = CollectorConfig(joint_names=("turn", "slide"), duration_s=20.0)
    return CollectorConfig.from_values(with_urdf_limits(vars(config), read_joints(SLIDE)))


def stalled_run(config, home, rng, longest_s, ticks):
    """A run whose driver holds each command; also how far a joint ever was beyond its range."""
    run, joints, command, beyond = CollectionRun(config), home, 0.0 * home, []
    now_s = ticked_s = stalls_s = ends_s = 5.0
    while not run.ended and now_s < 300.0:
        now_s, joints = now_s + DT_S, joints + DT_S * command
        beyond.append(np.maximum(config.lower_rad - joints, joints - config.upper_rad).max())
        if now_s > ends_s:
            stalls_s = now_s + rng.exponential(1.0)
            ends_s = stalls_s + rng.uniform(0.05, longest_s)
        stalled = now_s > stalls_s
        if not stalled:
            run.joint_states(now_s, now_s, joints)
            run.image(now_s, now_s, np.array([0.1, 0.2, 1.4]))
        if ticks or not stalled:
            command = run.tick(now_s, now_s - ticked_s)
            ticked_s = now_s
    return run, max(beyond)


@each(("longest_s", "ticks"), [(0.5, False), (9.0, True)])
def test_a_stall_takes_no_joint_beyond_its_range_and_the_run_goes_on(longest_s, ticks):
    near = {"joint_min_rad": tuple(HOME - 0.6), "joint_max_rad": tuple(HOME + 0.6)}
    arms = (
        (sliding_arm(), np.array([0.0, 0.1])),
        (CollectorConfig(duration_s=20.0, **near), HOME),
    )
    for seed, (config, home) in enumerate(arms):
        run, beyond = stalled_run(config, home, np.random.default_rng(seed), longest_s, ticks)
        assert run.state is State.DONE, run.reason
        assert run.progress == 1.0
        assert beyond <= 0.0
        assert len(run.samples[0]) > 500


@each("comes_s", [0.5, 4.0])  # in time, in motion
def test_ranges_that_come_late_hold_from_then_on(comes_s):
    joints = np.array([0.0, 0.1])
    run = CollectionRun(CollectorConfig(joint_names=("turn", "slide")))
    for tick in range(round(8.0 / DT_S)):
        now_s = 5.0 + DT_S * tick
        if tick == round(comes_s / DT_S):
            joints = np.array([0.0, 0.1])  # it may be anywhere before
            run.configure(sliding_arm())
        run.joint_states(now_s, now_s, joints)
        run.image(now_s, now_s, np.array([0.0, 0.0, 1.0]))
        command = run.tick(now_s, DT_S)
        waits = tick * DT_S < min(comes_s - DT_S, 2.0)
        assert not (waits and command.any())
        if tick * DT_S > comes_s + 0.5:
            assert abs(command[1]) <= 0.65 * 0.09 + 1e-9
            assert 0.01 <= joints[1] <= 0.19
        joints = joints + DT_S * command
    assert run.state is State.MOVING, run.reason


def test_it_waits_while_another_node_commands_the_arm():
    cell = Cell()
    cell.run.other_publishers(["/fvs_controller_node"])
    assert cell.advance(1.0) is State.WAITING
    assert "/fvs_controller_node commands the arm as well" in cell.run.reason
    cell.run.other_publishers([])
    assert cell.advance(0.5) is State.MOVING
    cell.run.other_publishers(["/fvs_controller_node"])
    assert cell.advance(1.0) is State.FAILED


def test_a_jerk_limit_holds_in_motion_and_while_it_stops_and_zeros_are_reached():
    config = CollectorConfig(
        duration_s=DURATION_S, joint_range_rad=(0.3,) * 6, max_joint_jerk_rad_s3=30.0
    )
    run, joints, commands = CollectionRun(config), HOME.copy(), []
    for tick in range(500):
        now_s = 5.0 + DT_S * tick
        run.joint_states(now_s, now_s, joints)
        run.image(now_s, now_s, np.array([0.0, 0.0, 1.0]))
        if tick == 350:
            assert np.abs(commands[-1]).max() > 0.3
            run.fail("enough")
        commands.append(run.tick(now_s, DT_S))
        joints = joints + DT_S * commands[-1]
    assert np.abs(np.diff(commands, 2, axis=0)).max() <= 30.0 * DT_S**2 + 1e-12
    assert run.ended


def camera_on_a_ur5(feature):
    """What its camera, on the flange, sees: a chain, with an object 0.35 m in front at HOME."""
    arm = kinematics(read_joints(find_file("robots/ur5.urdf").read_text("utf-8")))
    facing = np.array([0.03, -0.02, 0.35, *np.diag([1.0, -1.0, -1.0]).ravel()])
    chain = arm.chain(facing).moved(arm.tip_rotation.T, -arm.tip_rotation.T @ arm.tip_m)
    facing = facing[: {"ball": 3, "pose": 12}[feature]]
    return replace(chain, feature_m=facing, on_arm=True).anchored(HOME, facing)


@each(("feature", "half_rad", "losses"), [("pose", 0.3, 0), ("ball", 0.3, 0), ("pose", 0.12, 3)])
def test_the_object_stays_in_view_of_a_camera_on_the_arm(feature, half_rad, losses):
    chain, duration_s = camera_on_a_ur5(feature), 30.0
    run = CollectionRun(CollectorConfig(duration_s=duration_s, feature=feature, camera_mount="arm"))
    joints, states, rng = HOME, [], np.random.default_rng(0)
    while not run.ended and len(states) < 3.0 * duration_s / DT_S:
        now_s = 5.0 + DT_S * len(states)
        run.joint_states(now_s, now_s, joints)
        z = chain.position(joints)
        if len(states) % 4 == 0 and np.abs(np.arctan2(z[:2], z[2])).max() < half_rad:
            run.image(now_s, now_s, z + rng.normal(0.0, 2e-4, len(z)))
        joints = joints + DT_S * run.tick(now_s, DT_S)
        states.append(run.reason.startswith("no object"))
    assert run.state is State.DONE
    assert np.count_nonzero(np.diff(states) > 0) <= losses
    assert np.std([sample.joints_rad for sample in run.samples[0]], axis=0).min() > 0.05


# ---- the motion ---------------------------------------------------------------------------


def motion(**changes):
    values = {"duration_s": 120.0, "joint_range_rad": (0.6, *(0.5,) * 5), **changes}
    return RandomMotion(HOME, MotionConfig(**values), np.random.default_rng(0))


def path_of(motion, lag_s=0.0, dt_s=0.01):
    """Where an arm goes that follows with a first-order lag, rad, (k, n)."""
    joints, speed, path = HOME, np.zeros(6), []
    for k in range(12_000):
        speed = speed + dt_s / (lag_s + dt_s) * (motion.command(k * dt_s, joints) - speed)
        joints = joints + dt_s * speed
        path.append(joints)
    return np.array(path)


@each("half", [(0.6, *(0.5,) * 5), (0.05,) * 6])
def test_it_visits_every_part_of_every_pair_of_joints_evenly(half):
    unit = (path_of(motion(joint_range_rad=half)) - HOME) / half
    for i in range(6):
        for j in range(i):
            counts, _, _ = np.histogram2d(unit[:, i], unit[:, j], 3, [[-1, 1], [-1, 1]])
            assert counts.min() > 0.3 * counts.mean()


def test_joint_limits_cut_the_box():
    limited = motion(joint_max_rad=tuple(HOME + 0.3))
    assert np.all(path_of(limited, lag_s=0.03) <= HOME + 0.3)
    np.testing.assert_allclose(limited.box_rad[1], HOME + 0.1)  # joint_limit_margin_rad below
    with pytest.raises(ValueError, match=r"wrist_2_joint starts at -1\.57 rad \(m\), closer to an"):
        motion(joint_max_rad=tuple(HOME - 1.0))
