"""Two simulated webcams of which nothing is known: where their pictures bring the ball."""

from dataclasses import replace

import numpy as np
from cases import each

from fvs_ros.kinds.points import Points
from fvs_sim_node.config import SimConfig
from fvs_sim_node.simulation import Simulation
from fvs_tools.closed_loop import ClosedLoop

#: With 0.3 px of noise.
WEBCAMS = SimConfig(
    feature="points",
    points=Points(cameras=("front", "side")),
    rendered=False,
    position_noise_m=0.0015,
    image_rates_hz=(30.0, 20.0),
    latencies_s=(0.04, 0.07),
)


@each("scheme", ["best", "proposed"])
def test_two_pictures_are_a_place_and_one_is_a_line_of_sight(scheme):
    rng = np.random.default_rng(3)
    with Simulation(WEBCAMS) as simulation:
        loop, home = ClosedLoop.of_scheme(scheme, simulation), simulation.world.home_rad
        loop.run(0.3)
        for hidden in (False, False, True):
            joints = home + rng.uniform(-0.3, 0.3, home.size)
            place_m = simulation.world.chain.position(joints)
            pictures = simulation.true_chain().position(joints)
            loop.set_target(pictures)
            loop.run(0.15)
            covered = replace(WEBCAMS, camera_covered=hidden, covered_cameras=("side",))
            simulation.configure(covered)
            loop.run(2.5)
            off_px = np.abs(loop.true_feature - pictures)
            assert off_px[:2].max() < 0.3
            if not hidden:
                assert off_px[2:].max() < 0.3
                off_m = np.linalg.norm(simulation.world.carried_position() - place_m)
                assert off_m < 5e-4
