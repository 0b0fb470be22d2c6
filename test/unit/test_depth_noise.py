"""The depth noise has the spread, the correlation and the losses it promises."""

import numpy as np
import pytest
from cases import each

from fvs_sim_node.camera import add_depth_noise

FX = 615.0


def flat(depth_m=1.5, shape=(300, 300)):
    return np.full(shape, depth_m, np.float32)


def noisy(depth, scale=1.0, seed=0):
    return add_depth_noise(depth, FX, np.random.default_rng(seed), scale)


@each(("depth_m", "scale"), [(0.6, 1.0), (1.0, 1.0), (2.0, 1.0), (2.0, 2.0)])
def test_spread_grows_with_the_square_of_depth_and_comes_in_whole_millimetres(depth_m, scale):
    values = noisy(flat(depth_m), scale)
    errors = values[values > 0] - depth_m
    expected = np.hypot(scale * 0.08 * depth_m**2 / (FX * 0.05), 0.001 / np.sqrt(12))
    assert np.std(errors) == pytest.approx(expected, rel=0.03)
    assert abs(np.mean(errors)) < 0.03 * expected
    np.testing.assert_allclose(1e3 * values, np.round(1e3 * values), atol=1e-3)
    assert np.mean(values == 0.0) == pytest.approx(0.01 * scale, abs=0.002)


@each(
    ("jump_m", "scale", "share"),
    [(1.0, 1.0, 0.5), (0.1, 1.0, 0.5), (0.03, 1.0, 0.01), (1, 0.4, 0.2)],
)
def test_half_of_an_edge_is_lost_and_nothing_beside_it(jump_m, scale, share):
    depth = flat()
    depth[:, 150:] += jump_m
    values = noisy(depth, scale)
    assert np.mean(values[:, 149:151] == 0.0) == pytest.approx(share, abs=0.06)
    assert np.mean(values[:, 140:149] == 0.0) < 0.02
