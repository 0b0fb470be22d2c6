"""What is nearest within linear bounds."""

import numpy as np
import pytest

from fvs_ros.bounded import nearest


def test_bounds_push_as_little_as_needed():
    wanted, rows = np.array([1.0, 2.0]), np.array([[-1.0, 0.0], [0.0, 1.0]])
    command, pushes = nearest(wanted, rows, np.array([-0.5, -9.0]))
    assert command == pytest.approx([0.5, 2.0], abs=1e-3)
    assert pushes[0] > 0.0
    assert pushes[1] == 0.0
    assert nearest(wanted, rows, np.array([-1.0, -9.0]))[0] is wanted


def test_between_bounds_that_contradict_each_other():
    command, _ = nearest(np.zeros(1), np.array([[1.0], [-1.0]]), np.array([1.0, 0.5]))
    assert command == pytest.approx([0.25], abs=1e-3)


def test_of_many_bounds_the_nearest_is_found():
    generator = np.random.default_rng(1)
    for _ in range(300):
        bounds, size = generator.integers(1, (20, 8))
        rows, wanted = generator.normal(size=(bounds, size)), generator.normal(size=size)
        least = rows @ generator.normal(size=size) - generator.uniform(size=bounds)  # is possible
        command, pushes = nearest(wanted, rows, least)
        assert (rows @ command >= least - 1e-3 * (1.0 + pushes)).all()
        assert command - wanted == pytest.approx(pushes @ rows)
        assert (pushes >= 0.0).all()
        assert (pushes * (rows @ command - least) < 1e-9).all()  # only bounds that are met push
