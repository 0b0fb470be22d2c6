"""A hobby arm with its camera on the wrist: play, servos that stop short, coarse encoders."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from cases import each

from fvs_controller_node.reasons import Reason
from fvs_estimator_node.registry import create_estimator
from fvs_sim_node.config import SimConfig
from fvs_sim_node.simulation import Simulation
from fvs_tools.closed_loop import ClosedLoop

PLAY_RAD = 0.0175
VALUES = {"law": "minimum_time", "view_half_angles_deg": (27.0, 21.0), "settled_error_m": 0.0015}
STEPS = 4096
STOPS_SHORT = {"stops_short_rad": 0.0087, "encoder_steps": STEPS}


@each(("backlash_rad", "values"), [(PLAY_RAD, {}), (0.0, {"rest_when_settled": True})])
def test_servos_that_cannot_reach_a_target_exactly_rest_near_it(backlash_rad, values):
    config = SimConfig(
        **STOPS_SHORT,
        backlash_rad=backlash_rad,
        robot="so101",
        feature="ball",
        camera_mount="arm",
        command_interface="position",
        initial_joints_rad=(0.0, -0.35, 0.7, 0.6, 0.0),
        rendered=False,
        position_noise_m=0.0005,
    )
    with Simulation(config) as simulation:
        start, chain = simulation.joints_rad, simulation.true_chain()
        learned = SimpleNamespace(chain=replace(chain, play_rad=np.full(5, backlash_rad)))
        estimator = create_estimator("poe", {}, lambda: learned, simulation.kind)
        loop = ClosedLoop(simulation, estimator, {**VALUES, **values})
        loop.run(0.4)
        # The second one is within what counts as settled, but another target.
        for goal_rad in ([0.1, -0.1, 0.08, 0.06, 0.1], [0.1, -0.085, 0.08, 0.06, 0.1]):
            target = chain.position(start + goal_rad)
            loop.set_target(target)
            loop.run(3.0)
            motors_rad = simulation.advance().joints_rad
            for _ in range(125):
                command = loop.tick()
                assert command.reason is Reason.SETTLED
                assert not command.velocity_rad_s.any()
                assert np.linalg.norm(loop.true_feature - target) < 0.002
            moved_rad = simulation.advance().joints_rad - motors_rad  # a drive comes in slowly
            assert np.abs(moved_rad).max() < 1.01 * 2.0 * np.pi / STEPS
