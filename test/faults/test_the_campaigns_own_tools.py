"""The campaign's own checks can fail, and its wires do what they are told, by their seed."""

import math
import time

import pytest
from geometry_msgs.msg import PointStamped
from rig import ACCELERATION, LONGEST_TICK_S, VELOCITY, Sent, assert_sound
from wire import PREFIX, Wire

from fvs_ros import ros

TICK_S = 0.02


def ramp(steps, up=ACCELERATION * TICK_S):
    """Commands that speed up from rest, one a tick."""
    return [Sent(1.0 + TICK_S * k, (min(VELOCITY, up * k), *[0.0] * 5)) for k in range(steps)]


def test_a_ramp_within_the_limits_and_a_step_to_zero_are_sound():
    commands = ramp(10)
    assert_sound([*commands, Sent(1.2, (0.0,) * 6), Sent(1.22, (0.05, *[0.0] * 5))], 0.5)


def test_a_command_that_leaves_late_is_sound():
    commands = ramp(8)
    late = Sent(commands[4].sent_s + 0.8 * LONGEST_TICK_S, commands[4].values)
    moved = [Sent(max(c.sent_s, late.sent_s), c.values) for c in commands[5:]]
    assert_sound([*commands[:4], late, *moved], 0.5)


@pytest.mark.parametrize(
    "commands",
    [
        [Sent(1.0, (0.0,) * 5)],
        [Sent(1.0, (0.0, math.nan, 0.0, 0.0, 0.0, 0.0))],
        [Sent(1.0, (0.0,) * 6), Sent(1.02, (1.1 * VELOCITY, *[0.0] * 5))],
        [Sent(1.0, (0.0,) * 6), Sent(1.02, (0.6 * VELOCITY, *[0.0] * 5))],  # a jump
        [Sent(1.0, (0.2,) * 6), Sent(1.02, (-0.2,) * 6)],  # another, the other way
        ramp(6, up=2.4 * ACCELERATION * TICK_S)[:3] + [Sent(1.06, (0.5,) * 6)],
    ],
)
def test_an_unsound_command_is_found(commands):
    with pytest.raises(AssertionError):
        assert_sound(commands, 0.5)


def test_motion_before_the_start_is_found():
    assert_sound(ramp(5), 0.5)
    with pytest.raises(AssertionError, match="before the start"):
        assert_sound(ramp(5), 1.5)


def said_over(harness, seed, settings):
    """What of fifty points comes through a wire, and in which order."""
    topic = f"points_{seed}_{time.monotonic_ns()}"
    wire = Wire(harness.node, PointStamped, topic, seed)
    wire._seed = str(seed)  # not of the topic's name, which differs from run to run
    wire.calm()
    for name, value in settings.items():
        setattr(wire, name, value)
    heard = []
    harness.node.create_subscription(PointStamped, PREFIX + topic, heard.append, 200)
    publisher = harness.publisher(PointStamped, topic)
    harness.spin_until(lambda: wire._publisher.get_subscription_count() > 0)
    for k in range(50):
        count = wire.heard
        publisher.publish(ros.to_point(float(k), "frame", [float(k), 0.0, 0.0]))
        harness.spin_until(lambda c=count: wire.heard > c, what="the wire to hear it")
    harness.spin_until(lambda: len(heard) >= len(wire.said_s), what="all that was said")
    return [(m.point.x, ros.from_stamp(m.header.stamp)) for m in heard]


def test_a_wire_is_deterministic_by_its_seed(ros_test):
    settings = {"loss": 0.3, "repeat": 0.2, "swap": 0.2}
    one, again, other = (said_over(ros_test, seed, settings) for seed in (1, 1, 2))
    values = [x for x, _ in one]
    assert one == again != other
    assert 25 < len(set(values)) < 45
    assert len(values) > len(set(values))
    assert values != sorted(values)


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({}, [(float(k), float(k)) for k in range(50)]),
        ({"silent": True}, []),
        ({"shift_s": 5.0}, [(float(k), k + 5.0) for k in range(50)]),
        ({"freeze": "stamp"}, [(float(k), 0.0) for k in range(50)]),
        ({"freeze": "message"}, [(0.0, 0.0)] * 50),
    ],
)
def test_a_wire_does_what_it_is_told(ros_test, settings, expected):
    assert said_over(ros_test, 0, settings) == expected
