"""How do I try my own control law and estimator?

Derive them from `ControlLaw` and `Estimator` and put them into the registries. A law only proposes:
limits, checks and stops stay with the supervisor. `command` gets a
[`ControlInput`](../fvs_controller_node/base.py): error, Jacobian, joints, the last command, the
time since, the chain. Nodes, page and experiments know law and estimator, too, when your package
names them in its `pyproject.toml`:

    [project.entry-points."fvs_ros.laws"]
    mine = "my_package:MyLaw"
    [project.entry-points."fvs_ros.estimators"]
    mine = "my_package:MyEstimator"

Then `pip install -e ../my_package` into `.venv`, and `fvs_launch demo --scheme mine+mine`. Of the
experiments, `everyday`, `tags` and `robustness` take `--scheme`, such as
`fvs_experiments everyday --scheme mine+mine`, which needs `pip install -e '.[lab]'`. Gains are not
searched: your defaults count, if no other law has a gain of the same name.
"""

from dataclasses import dataclass

import numpy as np

from fvs_ros import ControlLaw, ControlOutput, Estimator
from fvs_ros.params import Parameters, live_parameter


@dataclass(frozen=True)
class MyGains(Parameters):
    """Parameters that this law adds to the controller node."""

    my_gain_1_s: float = live_parameter(8.0, "Gain of my law, 1/s.", 0.01, 100.0)


class MyLaw(ControlLaw):
    """Damped least squares."""

    Gains = MyGains

    def command(self, state):
        J, error_m = state.jacobian, state.error_m
        damped = J @ J.T + 1e-3 * np.eye(len(error_m))
        velocity = -self.gains.my_gain_1_s * J.T @ np.linalg.solve(damped, error_m)
        return ControlOutput.plain(velocity, len(error_m))


class MyEstimator(Estimator):
    """Broyden's update of the networks' Jacobian at the start."""

    made_from = "model"  # "model": the model's networks; "chain": its chain

    def __init__(self, source, config, kind):
        super().__init__(kind)
        self.source, self.J = source, None

    def jacobian(self, joints_rad, z=None):
        if self.J is None:
            self.J = self.source.jacobian(joints_rad)
        return self.J.copy()

    def update(self, step):
        moved_rad = step.d_joints_rad
        missed_m = step.d_feature_m - self.jacobian(step.joints_rad) @ moved_rad
        self.J += 0.5 * np.outer(missed_m, moved_rad) / (moved_rad @ moved_rad)


if __name__ == "__main__":
    from fvs_controller_node.config import LAWS
    from fvs_estimator_node.registry import ESTIMATORS
    from fvs_ros import ClosedLoop, SimConfig, Simulation

    LAWS["mine"], ESTIMATORS["mine"] = MyLaw, MyEstimator
    for scheme in ("mine+mine", "poe+mine", "rbf+pid", "best"):
        with Simulation(SimConfig(rendered=False, position_noise_m=0.001, seed=1)) as simulation:
            loop = ClosedLoop.of_scheme(scheme, simulation)
            loop.run(0.5)
            loop.set_target(loop.feature + [0.1, 0.2, 0.1])
            start_s = simulation.time_s
            while not loop.settled and simulation.time_s < start_s + 5.0:
                loop.tick()
            print(f"{scheme:10} {loop.status.text} after {simulation.time_s - start_s:.2f} s")
