"""The whole loop in lock step, without ROS: rendered camera, learning estimator, controller."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fvs_controller_node.reasons import State
from fvs_estimator_node.model_file import load_model
from fvs_lab.trials import jacobian_error
from fvs_sim_node.simulation import SimConfig, Simulation
from fvs_tools.closed_loop import ClosedLoop, make_estimator
from fvs_tools.demo import choose_target
from fvs_tools.score import settling_time_s

MODEL = load_model(Path(__file__).resolve().parents[2] / "config" / "models" / "ur5_front.npz")
TICK_S = 0.008
LIMIT_RAD_S = 1.0


class Recorded(ClosedLoop):
    """The loop in lock step, its commands kept."""

    def __init__(self, seed=0, method="rbf", **disturbances):
        simulation = Simulation(SimConfig(seed=seed, **disturbances))
        estimator = make_estimator(method, simulation)
        super().__init__(simulation, estimator, {"max_joint_velocity_rad_s": LIMIT_RAD_S})
        self.commands = []

    def tick(self):
        command = super().tick()
        self.commands.append(command.velocity_rad_s)
        return command

    def run(self, seconds):
        """True ball positions meanwhile."""
        positions = []
        for _ in range(round(seconds / TICK_S)):
            self.tick()
            positions.append(self.simulation.true_ball_position())
        return np.array(positions)

    def servo_to(self, target_m, seconds=3.0):
        """Times, s, and true errors, m, after a new target."""
        self.set_target(target_m)
        errors = np.linalg.norm(self.run(seconds) - target_m, axis=1)
        return TICK_S * np.arange(1, len(errors) + 1), errors


@pytest.fixture
def lock_step():
    made = []

    def make(**arguments):
        made.append(Recorded(**arguments))
        made[-1].run(0.3)
        return made[-1]

    yield make
    for one in made:
        one.simulation.close()


def next_target(one, rng, distance_m=0.3):
    return choose_target(MODEL.ball_samples_m, one.simulation.true_ball_position(), distance_m, rng)


@pytest.mark.parametrize("seed", range(2))
def test_from_a_third_of_a_metre_the_ball_is_on_target_in_time(lock_step, seed):
    one, rng = lock_step(seed=seed), np.random.default_rng(seed)
    for _ in range(2):
        times, errors = one.servo_to(next_target(one, rng))
        settled_s = settling_time_s(times, errors, 0.005)
        assert settled_s is not None
        assert settled_s < 1.5
        assert np.sqrt(np.mean(errors[times > 2.0] ** 2)) < 0.0015
    speeds = np.abs(one.commands)
    assert speeds.max() <= LIMIT_RAD_S
    assert np.abs(np.diff(one.commands, axis=0)).max() <= 6.0 * TICK_S + 1e-12


def test_the_same_seed_is_the_same_run_to_the_bit(lock_step):
    def errors():
        one, rng = lock_step(seed=5), np.random.default_rng(5)
        return one.servo_to(next_target(one, rng), 1.0)[1]

    np.testing.assert_array_equal(errors(), errors())


@pytest.mark.parametrize("latency_s", [0.0, 0.12])
def test_latency_is_predicted_away(lock_step, latency_s):
    one, rng = lock_step(latency_s=latency_s), np.random.default_rng(1)
    times, errors = one.servo_to(next_target(one, rng))
    settled_s = settling_time_s(times, errors, 0.005)
    assert settled_s is not None
    assert settled_s < 1.5


def test_learning_pays_when_the_camera_is_bumped(lock_step):
    """With the camera turned by 40 degrees, the online update gives a better Jacobian."""
    errors = {}
    for method in ("frozen", "rbf"):
        one, rng = lock_step(method=method), np.random.default_rng(2)
        one.simulation.camera = one.simulation.camera.turned(np.radians([0.0, 0.0, 40.0]))
        one.run(0.5)
        for _ in range(2):
            one.servo_to(next_target(one, rng, 0.2), 2.5)
        errors[method] = jacobian_error(one)
    assert errors["rbf"] < 0.7 * errors["frozen"]


def test_a_lost_ball_holds_the_arm_and_is_found_again(lock_step):
    one, rng = lock_step(), np.random.default_rng(4)
    target_m = next_target(one, rng)
    one.servo_to(target_m, 0.3)
    one.simulation.configure(replace(one.simulation.config, dropout=1.0))
    one.run(0.6)
    assert one.loop.supervisor.last.state is State.HOLDING
    assert not np.any(one.commands[-1])
    one.simulation.configure(replace(one.simulation.config, dropout=0.0))
    errors = np.linalg.norm(one.run(2.0) - target_m, axis=1)
    assert one.loop.supervisor.last.state is State.SERVOING
    assert errors[-1] < 0.005
