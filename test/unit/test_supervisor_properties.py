"""Whatever happens, in whatever order: six finite numbers within limits, no motion unasked."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fvs_controller_node.config import build_loop, default_values
from fvs_controller_node.reasons import State
from fvs_controller_node.supervisor import MAX_TICK_S

FRAME = "camera_color_optical_frame"
WILD = st.sampled_from([math.nan, math.inf, -math.inf, 1e300, -1e9, 0.0, 1e-300])
NUMBER = st.one_of(st.floats(-3.0, 3.0), WILD)
GOOD_JACOBIAN = np.eye(3, 6) * 0.5 + 0.1

EVENT = st.one_of(
    st.tuples(st.just("good"), st.integers(1, 40)),  # so many ticks with all inputs
    st.tuples(st.just("good"), st.integers(1, 40)),
    st.tuples(st.just("silent"), st.integers(1, 40)),  # so many ticks with none
    st.tuples(st.just("jump"), st.floats(-0.5, 2.0)),  # of the clock
    st.tuples(st.just("dt"), st.sampled_from([0.0, 0.002, 0.008, 0.3, -1.0, math.nan])),
    st.tuples(st.just("target"), st.lists(NUMBER, min_size=2, max_size=4)),
    st.tuples(st.just("target"), st.lists(st.floats(0.3, 0.9), min_size=3, max_size=3)),
    st.tuples(st.just("joints"), st.lists(NUMBER, min_size=0, max_size=8)),
    st.tuples(st.just("ball"), st.lists(NUMBER, min_size=0, max_size=4)),
    st.tuples(st.just("jacobian"), st.lists(NUMBER, min_size=18, max_size=18)),
    st.tuples(st.just("program"), st.booleans()),
    st.tuples(st.just("scaling"), st.one_of(NUMBER, st.just(100.0))),
    st.tuples(st.just("quality"), NUMBER),
    st.tuples(st.just("start"), st.none()),
    st.tuples(st.just("start"), st.none()),
    st.tuples(st.just("stop"), st.none()),
)


class World:
    """A loop, and the promises checked at every tick."""

    def __init__(self, **values) -> None:
        values = default_values(**values)
        self.loop = build_loop(values)
        self.max_speed = values["max_joint_velocity_rad_s"]
        self.max_acceleration = values["max_joint_acceleration_rad_s2"]
        self.now_s, self.dt_s, self.stamp_s = 10.0, 0.008, 10.0
        self.ticked_s = self.now_s
        self.joints = np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0])
        self.may_move = False
        self.last = np.zeros(6)
        self.moved = False

    def tick(self) -> None:
        step_s = self.dt_s if 0.0 < self.dt_s < math.inf else 0.0
        self.now_s += step_s
        self.stamp_s += step_s
        # Where simulated time stands still, the ramp to rest goes by the steady clock.
        passed_s = step_s or min(self.now_s - self.ticked_s, MAX_TICK_S)
        self.ticked_s = self.now_s
        command = self.loop.tick(self.now_s, self.dt_s)
        velocity = command.velocity_rad_s
        assert velocity.shape == (6,)
        assert velocity.dtype == np.float64
        assert np.all(np.isfinite(velocity))
        assert np.abs(velocity).max() <= self.max_speed
        change = np.abs(velocity - self.last).max()
        assert change <= self.max_acceleration * passed_s + 1e-12 or not velocity.any()
        if not self.may_move:
            assert not velocity.any()
        if command.state is State.FAULT:
            assert not velocity.any()
        assert command.text
        self.moved = self.moved or bool(velocity.any())
        self.last = velocity
        if step_s < 0.1:
            self.joints = self.joints + velocity * step_s

    def hear(self) -> None:
        self.loop.add_jacobian(self.now_s, GOOD_JACOBIAN)
        self.loop.add_joints(self.now_s, self.stamp_s, self.joints)
        ball = np.array([0.2, 0.1, 1.0]) + GOOD_JACOBIAN @ self.joints
        self.loop.add_ball(self.now_s, self.stamp_s - 0.03, ball, FRAME)

    def run(self, ticks: int, hear: bool) -> None:
        for _ in range(ticks):
            if hear:
                self.hear()
            self.tick()

    def jump(self, seconds: float) -> None:
        """The stamps' clock jumps either way, the steady one only on."""
        self.now_s += max(0.0, seconds)
        self.stamp_s += seconds

    def start(self) -> None:
        self.may_move = self.loop.supervisor.start(self.now_s)[0] or self.may_move

    def happen(self, what: str, value) -> None:
        loop, supervisor, now_s = self.loop, self.loop.supervisor, self.now_s
        happenings = {
            "good": lambda: self.run(value, hear=True),
            "silent": lambda: self.run(value, hear=False),
            "jump": lambda: self.jump(value),
            "dt": lambda: setattr(self, "dt_s", value),
            "target": lambda: supervisor.target(np.array(value), FRAME),
            "joints": lambda: loop.add_joints(now_s, self.stamp_s, np.array(value)),
            "ball": lambda: loop.add_ball(now_s, self.stamp_s, np.array(value), FRAME),
            "jacobian": lambda: loop.add_jacobian(now_s, np.array(value).reshape(3, 6)),
            "program": lambda: supervisor.program_running(value),
            "scaling": lambda: supervisor.speed_scaling(now_s, value),
            "quality": lambda: supervisor.estimator_quality(now_s, value),
            "start": self.start,
            "stop": supervisor.stop,
        }
        happenings[what]()
        self.tick()


@settings(max_examples=150, deadline=None)
@given(events=st.lists(EVENT, max_size=40), law=st.sampled_from(["ftsm", "proportional"]))
def test_no_sequence_of_events_breaks_a_promise(events, law):
    world = World(law=law)
    for event in events:
        world.happen(*event)


@settings(max_examples=60, deadline=None)
@given(events=st.lists(EVENT, max_size=30))
def test_nor_when_it_was_servoing_before(events):
    world = World(max_joint_velocity_rad_s=0.7, max_joint_acceleration_rad_s2=3.0)
    world.happen("target", [0.5, 0.4, 0.8])
    world.happen("good", 10)
    world.happen("start", None)
    world.happen("good", 20)
    assert world.moved
    for event in events:
        world.happen(*event)


@settings(max_examples=60, deadline=None)
@given(events=st.lists(EVENT.filter(lambda e: e[0] != "start"), max_size=30))
def test_nothing_but_a_start_starts_it(events):
    world = World()
    world.happen("target", [0.5, 0.4, 0.8])
    world.happen("good", 10)
    for event in events:
        world.happen(*event)
    assert not world.moved


@settings(max_examples=40, deadline=None)
@given(
    joints=st.lists(st.floats(-7.0, 7.0), min_size=6, max_size=6),
    seconds=st.floats(0.1, 2.0),
    target=st.lists(st.floats(0.3, 0.9), min_size=3, max_size=3),
)
def test_joints_never_pass_their_limits_by_its_doing(joints, seconds, target):
    world = World()
    lower, upper = (np.array(default_values()[name]) for name in ("joint_min_rad", "joint_max_rad"))
    world.joints = np.clip(joints, lower, upper)
    world.happen("target", target)
    world.happen("good", 10)
    world.happen("start", None)
    for _ in range(round(seconds / 0.008)):
        world.happen("good", 1)
        assert np.all(world.joints <= upper + 1e-9)
        assert np.all(world.joints >= lower - 1e-9)
