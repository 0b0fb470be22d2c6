"""The controller's parameters, and what is built from them."""

import numpy as np
import pytest
from cases import each

from fvs_controller_node.base import ControlInput
from fvs_controller_node.config import LAWS, default_values, make_law
from fvs_controller_node.ftsm import FtsmLaw
from fvs_controller_node.loop import ServoLoop
from fvs_controller_node.proportional import ProportionalGains, ProportionalLaw
from fvs_controller_node.redundancy import DampedInverse

JACOBIAN = np.random.default_rng(0).normal(size=(3, 6))


@each("seed", range(50))
@each("name", LAWS)
def test_every_law_is_built_by_name_and_finite_whatever_comes(name, seed):
    rng = np.random.default_rng(seed)
    weight, discretisation = 10.0 ** rng.uniform(-4.0, 2.0), ["implicit", "literal"][seed % 2]
    law = make_law(
        default_values(law=name, mfac_lambda=weight, mpc_q=weight, discretisation=discretisation)
    )
    # Numbers of any magnitude, and zeros.
    error, jacobian, applied = (
        rng.uniform(-1.0, 1.0, shape) * rng.choice([0.0, 1e-9, 1.0, 20.0], shape)
        for shape in (3, (3, 6), 6)
    )
    dt_s = 10.0 ** rng.uniform(-5.0, -1.0)
    out = law.command(ControlInput(error, jacobian, applied, np.zeros(6), dt_s))
    assert np.isfinite(out.velocity_rad_s).all()
    assert out.velocity_rad_s.shape == (6,)
    assert out.sliding_variable.shape == out.exponent.shape == (3,)


def test_the_proportional_law_closes_the_error_at_its_rate():
    law = ProportionalLaw(ProportionalGains(4.0), DampedInverse(1e-10))
    error = np.array([0.1, -0.2, 0.05])
    out = law.command(ControlInput(error, JACOBIAN, np.zeros(6), np.zeros(6), 0.008))
    np.testing.assert_allclose(JACOBIAN @ out.velocity_rad_s, -4.0 * error, rtol=1e-6)
    np.testing.assert_array_equal(out.sliding_variable, error)  # for the update law (45)
    with pytest.raises(ValueError, match="proportional_gain"):
        ProportionalGains(0.0)


def test_values_that_do_not_fit_together_change_nothing():
    loop = ServoLoop(default_values())
    law, config = loop.law, loop.supervisor.config
    with pytest.raises(ValueError, match="exponent"):
        loop.configure(default_values(lambda1=0.9, lambda2=0.4))
    with pytest.raises(ValueError, match="workspace"):
        loop.configure(default_values(workspace_min_m=[5.0, 0.0, 0.0]))
    with pytest.raises(ValueError, match="needs 3 numbers, got 2"):
        loop.configure(default_values(workspace_min_m=[0.0, 0.0], workspace_max_m=[1.0, 1.0]))
    assert loop.law is law
    assert loop.supervisor.config is config
    loop.configure(default_values(alpha2=1.0, max_joint_velocity_rad_s=0.2))
    assert isinstance(loop.law, FtsmLaw)
    assert loop.law.gains.surface.alpha2 == 1.0
    assert loop.supervisor.config.max_joint_velocity_rad_s == 0.2
