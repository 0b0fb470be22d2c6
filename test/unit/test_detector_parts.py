"""Pairing by stamps, and the gate against jumps: whatever comes in whatever order."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fvs_detector_node.detection import BallDetection
from fvs_detector_node.pairing import Pairing
from fvs_detector_node.tracking import Gate, WindowTracker
from fvs_ros.camera import Intrinsics

DT = 1 / 30
HERE, THERE = np.array([0.0, 0.0, 1.2]), np.array([0.5, 0.0, 1.2])


# --------------------------------------------------------------------------------- pairing
def feed(pairing, events):
    """Pairs as (colour, depth) stamps, ms, of events like ('colour', ms) and ('depth', ms)."""
    pairs = [pairing.add(kind, stamp_ms / 1000, stamp_ms) for kind, stamp_ms in events]
    return [(pair.colour, pair.depth) for pair in pairs if pair is not None]


def frames(*numbers, offset_ms=0):
    """Colour and depth of 30 Hz frames."""
    for n in numbers:
        yield "colour", 100 * n // 3
        yield "depth", 100 * n // 3 + offset_ms


STAMPS_MS = st.integers(-50, 400) | st.sampled_from([-(10**9), 10**9, 10**6])


@given(st.lists(st.tuples(st.sampled_from(["colour", "depth"]), STAMPS_MS), max_size=120))
@settings(max_examples=200, deadline=None)
def test_pairs_advance_and_keep_the_tolerance_whatever_comes(events):
    pairing = Pairing(0.015)
    last_s, restarts = float("-inf"), 0
    for kind, stamp_ms in events:
        pair = pairing.add(kind, stamp_ms / 1000, stamp_ms)
        if pairing.restarts != restarts:
            last_s, restarts = float("-inf"), pairing.restarts
        if pair is not None:
            assert abs(pair.depth - pair.colour) <= 15
            assert pair.stamp_s > last_s
            last_s = pair.stamp_s
    found = feed(pairing, frames(*range(10**8, 10**8 + 30)))
    assert len(found) >= 20


# ------------------------------------------------------------------------------------ gate
def accepted(gate, positions, start=0):
    return [gate.check((start + i) * DT, p) == "" for i, p in enumerate(positions)]


def test_one_wrong_thing_is_refused_with_the_numbers_and_a_ball_that_moved_is_accepted():
    gate = Gate(3.0)
    assert accepted(gate, [HERE, THERE, HERE, THERE, THERE, THERE, HERE]) == [
        True, False, True, False, False, True, False,
    ]  # fmt: skip
    assert gate.refused == 4
    text = Gate(3.0)
    text.check(0.0, HERE)
    said = text.check(DT, THERE)
    assert "0.50 m in 0.033 s" in said
    assert "max_ball_speed_m_s (3)" in said


def test_noise_is_no_jump_however_slow_the_ball_must_be_and_a_decimetre_is():
    gate, rng = Gate(0.02), np.random.default_rng(0)
    assert all(accepted(gate, HERE + 0.002 * rng.normal(size=(100, 3))))
    assert gate.check(100 * DT, HERE + [0.03, 0.0, 0.0])


# ---------------------------------------------------------------------------------- window
CAMERA = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)


def holds(tracker, stamp_s, position_m, radius_m=0.04):
    """Whether the window of an image holds the whole ball."""
    (u, v), region = CAMERA.project(position_m), tracker.region(stamp_s)
    return not region.cuts_off(u, v, radius_m * CAMERA.fx / position_m[2], CAMERA)


def tracker_of(*positions_m, dt_s=1 / 15):
    """A tracker that has seen a ball, radius 0.04 m, at positions, one image each."""
    tracker = WindowTracker(CAMERA, 0.04)
    for k, position_m in enumerate(positions_m):
        tracker.update(k * dt_s, BallDetection(np.array(position_m), 1.0, 1.0, 0.0, 20.0))
    return tracker


@given(st.floats(0.0, 6.28))
def test_the_window_holds_a_ball_that_moves_as_fast_as_an_arm_can_and_is_no_larger(angle):
    dt_s = 1 / 15
    way = np.array([np.cos(angle), np.sin(angle), 0.0])
    once, twice = tracker_of(HERE), tracker_of(HERE, HERE)
    assert holds(once, dt_s, HERE + 2.0 * dt_s * way)
    assert once.region(dt_s).width < 200
    assert holds(twice, 2 * dt_s, HERE + 12.0 * dt_s**2 * way)
    assert twice.region(2 * dt_s).width < 120
