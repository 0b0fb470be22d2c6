"""Images far noisier than was supposed: learned, and not thrown back at the arm."""

from dataclasses import replace

import numpy as np
import pytest

from fvs_lab.trials import HOME_RAD, Conditions
from fvs_sim_node.simulation import Simulation
from fvs_tools.closed_loop import ClosedLoop
from fvs_tools.schemes import scheme


@pytest.mark.parametrize(
    ("noise_m", "image_rate_hz", "after_s"),
    # With fewer images it takes longer to know how noisy they are, and the arm swings until then.
    [(0.006, 30.0, 2.5), (0.010, 30.0, 2.5), (0.010, 10.0, 11.0)],
)
@pytest.mark.parametrize("name", ["best", "extended"])
def test_an_arm_that_is_sent_off_at_once_comes_to_rest_all_the_same(
    name, noise_m, image_rate_hz, after_s
):
    config = replace(Conditions(rendered=False).sim_config(), image_rate_hz=image_rate_hz)
    one, simulation = scheme(name), Simulation(config)
    # The cases that went wrong once did so by chance: several, one after another.
    for seed in range(2):
        simulation.reset(HOME_RAD - 0.3)
        target_m = simulation.true_ball_position()
        simulation.reset(HOME_RAD + 0.2, seed)
        loop = ClosedLoop.of_scheme(one, simulation)
        simulation.position_noise = lambda rng: noise_m * rng.normal(size=3)
        try:
            loop.run(0.5)
            loop.set_target(target_m)
            loop.run(after_s)
            errors_m, speeds = [], []
            for _ in range(round(2.0 / loop.period_s)):
                speeds.append(np.abs(loop.tick().velocity_rad_s).max())
                errors_m.append(np.linalg.norm(simulation.true_ball_position() - target_m))
        finally:
            simulation.position_noise = None
        assert np.sqrt(np.mean(np.square(errors_m))) < 0.5 * noise_m
        assert max(speeds) < 0.1
        assert loop.loop.predictor.tracker.noise_m == pytest.approx(noise_m, rel=0.3)
