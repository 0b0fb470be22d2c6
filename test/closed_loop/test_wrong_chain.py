"""A chain that is not this arm's is a wrong Jacobian: the arm is held, and its reason named."""

import numpy as np
import pytest

from fvs_controller_node.reasons import Reason
from fvs_ros import ClosedLoop, SimConfig, Simulation
from fvs_ros.chain import SerialChain


def turned(chain):
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return chain.moved(quarter, np.zeros(3))


def reversed_axes(chain):
    return SerialChain(-chain.axes, chain.points_m, chain.ball_m, chain.reference_rad)


@pytest.mark.parametrize("wrong", [turned, reversed_axes])
def test_an_arm_that_is_sent_a_wrong_chain_is_held(wrong):
    simulation = Simulation(SimConfig(seed=1, rendered=False, position_noise_m=1e-3))
    loop = ClosedLoop.of_scheme("best", simulation)
    loop.run(0.5)
    right = loop.loop.add_chain
    loop.loop.add_chain = lambda now_s, chain: right(now_s, wrong(chain))
    loop.set_target(loop.ball_m + [0.0, 0.2, 0.1])
    reasons = []
    for _ in range(125):
        reasons.append(loop.tick().reason)
    assert reasons[-1] is Reason.PREDICTION_ERROR
    assert not loop.loop.supervisor.started
