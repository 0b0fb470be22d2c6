"""The view of a camera on the arm: margins, and the commands that keep them."""

import numpy as np
import pytest
from cases import each

from fvs_ros.kinds import KINDS
from fvs_ros.params import ParameterError
from fvs_ros.rotations import rotation_from_vector
from fvs_ros.view import WHERE, Barrier, ViewConfig

VIEW = ViewConfig((30.0, 20.0), (0.2, 2.0), 60.0, 0.05)
FACING = np.diag([1.0, -1.0, -1.0])


def seen(name, position_m, turned_rad=(0.0, 0.0, 0.0)):
    kind = KINDS[name](camera_mount="arm")
    return kind, kind.of_body(
        np.array(position_m), rotation_from_vector(np.array(turned_rad)) @ FACING
    )


@each(
    ("where", "position_m", "margin_m"),
    [
        (0, (-0.3, 0.0, 1.0), 0.5 - 0.3 * 0.75**0.5 - 0.05),
        (1, (0.6, 0.0, 1.0), 0.5 - 0.6 * 0.75**0.5 - 0.05),
        (2, (0.0, -0.1, 1.0), np.sin(0.349066) - 0.1 * np.cos(0.349066) - 0.05),
        (3, (0.0, 0.0, 1.0), np.sin(0.349066) - 0.05),
        (4, (0.0, 0.0, 0.3), 0.1),
        (5, (0.0, 0.0, 2.5), -0.5),
    ],
)
def test_margins_are_distances_from_the_planes_around_the_view(where, position_m, margin_m):
    kind, z = seen("ball", position_m)
    margins_m, _ = VIEW.margins(kind, z)
    assert margins_m[where] == pytest.approx(margin_m, abs=1e-6)
    assert (WHERE[where] in VIEW.out_of_view(kind, z)) == (margin_m < 0.0)


def test_a_tag_is_too_flat_from_the_largest_tilt_on():
    for tilt_deg in (59.0, 61.0):
        kind, z = seen("pose", (0.0, 0.0, 1.0), np.radians([0.0, tilt_deg, 0.0]))
        arc_m = VIEW.margins(kind, z)[0][-1]
        assert arc_m == pytest.approx(kind.lever_arm_m * np.radians(60.0 - tilt_deg), rel=0.01)
        assert (VIEW.out_of_view(kind, z) == "") == (tilt_deg < 60.0)


@each("name", ["ball", "pose"])
def test_the_slopes_are_the_derivatives_of_the_margins(name):
    kind, z = seen(name, (0.2, -0.1, 0.8), (0.3, -0.4, 0.7))
    margins_m, slopes = VIEW.margins(kind, z)
    for i, step_m in enumerate(1e-6 * np.eye(kind.size)):
        ahead, back = (VIEW.margins(kind, kind.retract(z, s * step_m))[0] for s in (1.0, -1.0))
        assert (ahead - back) / 2e-6 == pytest.approx(slopes[:, i], abs=1e-7)
    assert len(margins_m) == (7 if name == "pose" else 6)


def test_a_command_is_changed_where_it_leaves_the_view_and_only_as_far_as_needed():
    generator = np.random.default_rng(1)
    unit = np.ones(6)
    for _ in range(200):
        rows, closing = generator.normal(size=(3, 6)), 1.5 - generator.normal(size=3)
        errors, wanted = 0.2 * np.linalg.norm(rows, axis=1), generator.normal(size=6)
        barrier = Barrier(rows, closing, 0.2)

        def kept(command, errors=errors, rows=rows, closing=closing):
            return (rows @ command + closing >= errors * np.linalg.norm(command)).all()

        command, where = barrier.nearest(wanted, unit)
        assert kept(wanted) == (not where) == (command is wanted)
        assert kept(0.99 * command) or closing.min() < 0.0
        # Hardly any other command that keeps the margins is nearer.
        for other in command + 0.1 * generator.normal(size=(20, 6)):
            if kept(other):
                assert np.linalg.norm(other - wanted) > np.linalg.norm(command - wanted) - 0.05
        shorter = barrier.shortened(wanted)
        assert (-rows @ shorter <= np.maximum(0.0, closing) + 1e-9).all()


def test_what_is_outside_turns_back_and_a_fast_command_keeps_further_inside():
    kind, outside = seen("ball", (0.0, 0.0, 0.15))
    _, near = seen("ball", (0.0, 0.0, 0.21))
    jacobian, still, unit = np.eye(3), np.zeros(3), np.ones(3)
    command, where = VIEW.barrier(kind, outside, jacobian, still).nearest(still, unit)
    assert where == "too near" or "edge" in where  # as near as that, the edges are near as well
    assert command[2] > 0.2
    wide = ViewConfig((80.0, 80.0), (0.2, 2.0), 60.0, 0.0)
    bound = wide.barrier(kind, near, jacobian, still)  # may fall at 0.05 m/s
    slow, fast = np.array([0.2, 0.0, 0.0]), np.array([0.5, 0.0, 0.0])
    assert bound.nearest(still, unit)[1] == bound.nearest(slow, unit)[1] == ""
    inward, where = bound.nearest(fast, unit)
    assert where == "too near"
    assert inward == pytest.approx([0.5, 0.0, 0.05], abs=2e-3)
    # Motion that is still to come counts.
    coming = wide.barrier(kind, near, jacobian, np.array([0.0, 0.0, -0.02]))
    assert coming.nearest(still, unit)[1] == "too near"
    # So does the object's own motion: to follow it is not to lose it.
    away_m_s = np.array([0.0, 0.0, 0.1])
    followed = wide.barrier(kind, near, jacobian, still, away_m_s)
    assert followed.nearest(-away_m_s, unit)[1] == ""
    assert np.array_equal(followed.shortened(-away_m_s), -away_m_s)


def test_a_view_that_ends_before_it_begins_is_refused():
    with pytest.raises(ParameterError, match="must rise"):
        ViewConfig(view_distance_m=(2.0, 1.0))
