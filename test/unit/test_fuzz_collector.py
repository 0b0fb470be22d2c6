"""Whatever a collection run is told, in whatever order: commands within limits, none unasked."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fvs_estimator_node.collecting import CollectionRun, CollectorConfig, State

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of numpy, about wild numbers

HOME = np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0])
DT_S, LONGEST_S = 0.008, 0.05
WILD = (1e308, -1e300, 5e-324, 1e9, 100.0, 0.0, -7.0)

SCENE = st.tuples(
    st.sampled_from(
        [
            *("good", "good", "good", "no joints", "no ball", "frozen", "stalled", "still"),
            *("late", "jump", "wild joints", "wild ball", "fail", "odd dt"),
        ]
    ),
    st.integers(1, 50),
    st.integers(0, 2**16),
)


class Cell:
    """A collection run, an arm of some kind, and the promises checked at every tick."""

    def __init__(self, velocity, acceleration, plant):
        config = CollectorConfig(
            duration_s=10.0,
            joint_range_rad=(0.1,) * 6,
            max_joint_velocity_rad_s=velocity,
            max_joint_acceleration_rad_s2=acceleration,
        )
        self.velocity, self.acceleration, self.plant = velocity, acceleration, plant
        self.run = CollectionRun(config)
        self.now_s = self.stamp_s = self.ticked_s = 5.0
        self.joints, self.last = HOME.copy(), np.zeros(6)
        self.beats = self.moving = 0
        self.heard_joints_s = self.heard_ball_s = -math.inf
        self.newest = {"joints": -math.inf, "ball": -math.inf}

    def tick(self, dt_s):
        before = self.run.state
        command = self.run.tick(self.now_s, dt_s)
        assert command.shape == (6,)
        assert command.dtype == np.float64
        assert np.all(np.isfinite(command))
        assert np.abs(command).max() <= self.velocity
        dt_s = min(max(dt_s, 0.0), LONGEST_S) if math.isfinite(dt_s) else 0.0
        steady_s = min(max(self.now_s - self.ticked_s, 0.0), LONGEST_S)
        self.ticked_s = self.now_s
        change = np.abs(command - self.last).max()
        assert change <= self.acceleration * (dt_s or steady_s) + 1e-12
        if self.run.state not in (State.MOVING, State.RETURNING):
            assert np.all(np.abs(command) <= np.abs(self.last))
        if self.heard_joints_s == -math.inf or self.heard_ball_s == -math.inf:
            assert not command.any()
        if self.run.state in (State.MOVING, State.RETURNING):
            assert self.now_s - self.heard_joints_s <= 0.1
        if before in (State.DONE, State.FAILED):
            assert self.run.state is before
        assert self.run.reason
        assert 0.0 <= self.run.progress <= 1.0
        self.moving += bool(command.any())
        self.last = command
        share = {"obeys": 1.0, "ignores": 0.0, "inverts": -1.0}[self.plant]
        self.joints = self.joints + share * command * (dt_s or steady_s)

    def hear_joints(self, joints, stamp_s):
        if stamp_s > self.newest["joints"] or stamp_s < self.newest["joints"] - 0.1:
            self.newest["joints"], self.heard_joints_s = stamp_s, self.now_s
        self.run.joint_states(self.now_s, stamp_s, joints)

    def hear_ball(self, ball, stamp_s):
        if stamp_s > self.newest["ball"] or stamp_s < self.newest["ball"] - 0.1:
            self.newest["ball"], self.heard_ball_s = stamp_s, self.now_s
        self.run.ball(self.now_s, stamp_s, ball)

    def pass_time(self, joints=True, ball=True, steady_s=DT_S, stamp_s=DT_S, dt_s=None):
        self.beats += 1
        self.now_s += steady_s
        self.stamp_s += stamp_s
        if joints:
            self.hear_joints(self.joints.copy(), self.stamp_s)
        if ball and self.beats % 4 == 0:
            self.hear_ball(np.array([0.1, 0.2, 1.4]) + 0.3 * self.joints[:3], self.stamp_s - 0.03)
        self.tick(steady_s if dt_s is None else dt_s)

    def happen(self, what, ticks, seed):
        rng = np.random.default_rng(seed)
        if what == "jump":
            self.stamp_s += float(rng.choice([-100.0, -0.5, -0.05, 0.5, 100.0]))
            self.now_s += float(rng.choice([0.0, 0.2, 5.0, 15.0]))
        elif what == "fail":
            self.run.fail("told to")
        for _ in range(ticks):
            if what == "no joints":
                self.pass_time(joints=False)
            elif what == "no ball":
                self.pass_time(ball=False)
            elif what == "frozen":
                self.pass_time(stamp_s=0.0)
            elif what == "stalled":
                self.pass_time(steady_s=0.0)
            elif what == "still":
                self.pass_time(dt_s=0.0)
            elif what == "late":
                self.pass_time(steady_s=0.09, stamp_s=0.09)
            elif what == "odd dt":
                self.pass_time(dt_s=float(rng.choice([-1.0, 0.0, 1e-300, 10.0, math.inf])))
            elif what == "wild joints" and rng.random() < 0.3:
                joints = self.joints.copy()
                joints[rng.integers(6)] = rng.choice(WILD)
                self.stamp_s += 1e-4
                self.hear_joints(joints, self.stamp_s)
                self.pass_time()
            elif what == "wild ball" and rng.random() < 0.3:
                self.hear_ball(rng.choice(WILD, 3), self.stamp_s + 1e-4)
                self.pass_time()
            else:
                self.pass_time()


@settings(
    max_examples=120,
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
@given(
    scenes=st.lists(SCENE, min_size=1, max_size=8),
    velocity=st.floats(0.3, 3.0),
    acceleration=st.floats(0.5, 40.0),
    plant=st.sampled_from(["obeys", "obeys", "ignores", "inverts"]),
    rehearsed=st.booleans(),
)
def test_no_sequence_breaks_a_promise(scenes, velocity, acceleration, plant, rehearsed):
    cell = Cell(velocity, acceleration, plant)
    if rehearsed:
        cell.happen("good", 60, 0)
        assert cell.moving
    for scene in scenes:
        cell.happen(*scene)


def test_a_time_step_that_is_not_a_number():
    cell = Cell(0.65, 3.0, "obeys")
    cell.happen("good", 60, 0)
    cell.pass_time(dt_s=math.nan)


def test_one_wild_joint_state_does_not_end_the_motion_for_ever():
    cell = Cell(0.65, 3.0, "obeys")
    cell.happen("good", 60, 0)
    cell.stamp_s += 1e-4
    cell.hear_joints(np.full(6, -1.7e308), cell.stamp_s)
    cell.tick(DT_S)
    cell.happen("good", 60, 0)
    assert cell.run.state is not State.MOVING or cell.last.any()
