"""The campaign's own checks can fail, and its wires do what they are told, by their seed."""

import math
import time

import pytest
from geometry_msgs.msg import PointStamped
from rig import ACCELERATION, VELOCITY, Sent, assert_sound
from wire import PREFIX, Wire

from fvs_ros import ros

STEP_RAD_S = 0.02 * ACCELERATION


def at_20_ms(*speeds):
    """Commands of one joint, rad/s, one in 20 ms."""
    return [Sent(1.0 + 0.02 * k, (speed, *[0.0] * 5)) for k, speed in enumerate(speeds)]


RAMP = at_20_ms(*(min(VELOCITY, k * STEP_RAD_S) for k in range(8)))


def test_a_ramp_that_stops_at_once_or_leaves_late_is_sound():
    assert_sound([*RAMP, Sent(1.16, (0.0,) * 6)], 0.5)
    late = [Sent(max(c.sent_s, 1.12), c.values) for c in RAMP[4:]]
    assert_sound(RAMP[:4] + late, 0.5)


@pytest.mark.parametrize(
    ("commands", "started_s"),
    [
        ([Sent(1.0, (0.0,) * 5)], 0.5),
        (at_20_ms(math.nan), 0.5),
        (at_20_ms(0.0, 1.1 * VELOCITY), 0.5),
        (at_20_ms(0.0, 0.6 * VELOCITY), 0.5),  # a jump
        (at_20_ms(0.2, -0.2), 0.5),
        (at_20_ms(*(2.4 * STEP_RAD_S * k for k in range(3))), 0.5),
        (RAMP, 1.5),  # motion before the start
    ],
)
def test_an_unsound_command_is_found(commands, started_s):
    with pytest.raises(AssertionError):
        assert_sound(commands, started_s)


def heard_over_a_wire(harness, seed, settings):
    """What of fifty points comes through: (value, stamp, s), in order."""
    topic = f"points_{seed}_{time.monotonic_ns()}"
    wire = Wire(harness.node, PointStamped, topic, seed)
    wire._seed = str(seed)  # not of the topic's name, which differs from run to run
    wire.calm()
    vars(wire).update(settings)
    heard = []
    harness.node.create_subscription(PointStamped, PREFIX + topic, heard.append, 200)
    publisher = harness.publisher(PointStamped, topic)
    harness.spin_until(lambda: wire._publisher.get_subscription_count() > 0)
    for k in range(50):
        count = wire.heard
        publisher.publish(ros.to_point(float(k), "frame", [float(k), 0.0, 0.0]))
        harness.spin_until(lambda c=count: wire.heard > c, what="the wire to hear it")
    harness.spin_until(lambda: len(heard) >= len(wire.said_s), what="all that was sent")
    return [(m.point.x, ros.from_stamp(m.header.stamp)) for m in heard]


def test_a_wire_is_deterministic_by_its_seed(ros_test):
    settings = {"loss": 0.3, "repeat": 0.2, "swap": 0.2}
    one, again, other = (heard_over_a_wire(ros_test, seed, settings) for seed in (1, 1, 2))
    values = [x for x, _ in one]
    assert one == again != other
    assert 25 < len(set(values)) < min(45, len(values))
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
    assert heard_over_a_wire(ros_test, 0, settings) == expected
