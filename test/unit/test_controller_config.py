"""The controller's parameters, and what is built from them."""

from __future__ import annotations

import numpy as np
import pytest

from fvs_controller_node.base import ControlInput
from fvs_controller_node.config import LAWS, default_values, make_law
from fvs_controller_node.ftsm import FtsmLaw
from fvs_controller_node.loop import ServoLoop
from fvs_controller_node.proportional import ProportionalGains, ProportionalLaw
from fvs_controller_node.redundancy import DampedInverse
from fvs_ros.params import ParameterError

JACOBIAN = np.random.default_rng(0).normal(size=(3, 6))


@pytest.mark.parametrize("name", LAWS)
def test_every_law_is_built_by_name_and_answers(name: str):
    law = make_law(default_values(law=name))
    law.reset()
    out = law.command(ControlInput(np.full(3, 0.1), JACOBIAN, np.zeros(6), np.zeros(6), 0.008))
    assert out.velocity_rad_s.shape == (6,)
    assert out.sliding_variable.shape == out.exponent.shape == (3,)
    assert (JACOBIAN @ out.velocity_rad_s) @ np.full(3, 0.1) < 0.0  # towards the target


def test_an_unknown_law_is_refused_with_those_known():
    with pytest.raises(ParameterError, match="one of ftsm, proportional, mfac, mpc"):
        default_values(law="mystery")


def test_the_proportional_law_closes_the_error_at_its_rate():
    law = ProportionalLaw(ProportionalGains(4.0), DampedInverse(1e-10))
    error = np.array([0.1, -0.2, 0.05])
    out = law.command(ControlInput(error, JACOBIAN, np.zeros(6), np.zeros(6), 0.008))
    np.testing.assert_allclose(JACOBIAN @ out.velocity_rad_s, -4.0 * error, rtol=1e-6)
    np.testing.assert_array_equal(out.sliding_variable, error)  # for the update law (45)
    with pytest.raises(ValueError, match="proportional_gain"):
        ProportionalGains(0.0)


def test_the_exponent_is_fixed_and_freed_live():
    loop = ServoLoop(default_values())
    state = ControlInput(np.full(3, 0.1), JACOBIAN, np.zeros(6), np.zeros(6), 0.008)
    adaptive = loop.law.command(state)
    loop.configure(default_values(lambda1=0.6, lambda2=0.0))
    fixed = loop.law.command(state)
    np.testing.assert_array_equal(fixed.exponent, np.full(3, 0.6))
    assert np.abs(fixed.velocity_rad_s - adaptive.velocity_rad_s).max() > 1e-3
    loop.configure(default_values())
    np.testing.assert_array_equal(loop.law.command(state).exponent, adaptive.exponent)


def test_every_gain_of_every_law_is_live():
    for law in LAWS.values():
        assert all(parameter.live for parameter in law.PARAMETERS)


def test_values_that_do_not_fit_together_change_nothing():
    loop = ServoLoop(default_values())
    law, config = loop.law, loop.supervisor.config
    with pytest.raises(ValueError, match="exponent"):
        loop.configure(default_values(lambda1=0.9, lambda2=0.4))
    with pytest.raises(ValueError, match="workspace"):
        loop.configure(default_values(workspace_min_m=[5.0, 0.0, 0.0]))
    assert loop.law is law
    assert loop.supervisor.config is config
    loop.configure(default_values(alpha2=1.0, max_joint_velocity_rad_s=0.2))
    assert isinstance(loop.law, FtsmLaw)
    assert loop.law.surface.alpha2 == 1.0
    assert loop.supervisor.config.speed.max_joint_velocity_rad_s == 0.2
