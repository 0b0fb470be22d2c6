"""The controller's parameters, and what is built from them."""

import numpy as np
import pytest

from fvs_controller_node.base import ControlInput
from fvs_controller_node.config import default_values
from fvs_controller_node.ftsm import FtsmLaw
from fvs_controller_node.loop import ServoLoop
from fvs_controller_node.proportional import ProportionalGains, ProportionalLaw
from fvs_controller_node.redundancy import DampedInverse

JACOBIAN = np.random.default_rng(0).normal(size=(3, 6))


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
    with pytest.raises(ValueError, match="object_may_be_hidden_s is not for camera_mount arm"):
        loop.configure(default_values(camera_mount="arm", object_may_be_hidden_s=1.0))
    assert loop.law is law
    assert loop.supervisor.config is config
    loop.configure(default_values(alpha2=1.0, max_joint_velocity_rad_s=0.2))
    assert isinstance(loop.law, FtsmLaw)
    assert loop.law.gains.surface.alpha2 == 1.0
    assert loop.supervisor.config.max_joint_velocity_rad_s == 0.2
