"""A hobby arm with its camera on the wrist: play, servos that stop short, coarse encoders."""

from types import SimpleNamespace

import numpy as np

from fvs_controller_node.reasons import Reason
from fvs_estimator_node.registry import create_estimator
from fvs_sim_node.config import SimConfig
from fvs_sim_node.simulation import Simulation
from fvs_tools.closed_loop import ClosedLoop

STEPS = 4096
POOR = {"backlash_rad": 0.0175, "stops_short_rad": 0.0087, "encoder_steps": STEPS}


def test_play_that_the_controller_knows_holds_no_arm():
    config = SimConfig(
        **POOR,
        robot="so101",
        feature="ball",
        camera_mount="arm",
        command_interface="position",
        initial_joints_rad=(0.0, -0.35, 0.7, 0.6, 0.0),
        rendered=False,
        position_noise_m=0.0005,
    )
    with Simulation(config) as simulation:
        start = simulation.joints_rad
        target = simulation.true_chain().position(start + [0.1, -0.1, 0.08, 0.06, 0.1])
        learned = SimpleNamespace(chain=simulation.true_chain())
        estimator = create_estimator("poe", {}, lambda: learned, simulation.kind)
        values = {"law": "minimum_time", "joint_backlash_rad": POOR["backlash_rad"]}
        loop = ClosedLoop(simulation, estimator, values)
        loop.run(0.4)
        loop.set_target(target)
        loop.run(3.0)
        joints_rad, errors_m = [], []
        for _ in range(125):
            command = loop.tick()
            joints_rad.append(simulation.joints_rad)
            errors_m.append(np.linalg.norm(loop.true_feature - target))
    assert command.reason is Reason.SETTLED
    assert max(errors_m) < 0.002
    assert np.ptp(joints_rad, axis=0).max() < 2.0 * 2.0 * np.pi / STEPS
