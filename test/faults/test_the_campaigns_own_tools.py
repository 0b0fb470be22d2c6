"""The campaign's own checks can fail, and its wires do what they are told, by their seed."""

import math

import pytest
from rig import ACCELERATION, VELOCITY, Sent, assert_sound

STEP_RAD_S = 0.02 * ACCELERATION


def at_20_ms(*speeds):
    """Commands of one joint, rad/s, one in 20 ms."""
    return [Sent(1.0 + 0.02 * k, (speed, *[0.0] * 5)) for k, speed in enumerate(speeds)]


RAMP = at_20_ms(*(min(VELOCITY, k * STEP_RAD_S) for k in range(8)))


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
