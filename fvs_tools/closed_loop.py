"""The whole loop without ROS: a servo with a simulated arm and camera, in lock step.

A run is a bit-exact function of its configuration and seed.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache, partial
from typing import Any

import numpy as np

from fvs_controller_node.supervisor import Command
from fvs_estimator_node.base import Estimator
from fvs_estimator_node.files import TrainedModel, load_model
from fvs_estimator_node.registry import create_estimator
from fvs_ros.kinds import Kind, KindConfig
from fvs_ros.paths import find_file
from fvs_sim_node.simulation import Simulation
from fvs_tools.schemes import Scheme
from fvs_tools.schemes import scheme as scheme_called
from fvs_tools.servo import Servo


@lru_cache(maxsize=4)
def _load(joint_names: tuple[str, ...], kind: Kind) -> TrainedModel:
    return load_model(find_file(kind.model), joint_names, KindConfig.from_values(kind.values))


def make_estimator(
    method: str,
    simulation: Simulation,
    values: Mapping[str, Any] | None = None,
    kind: Kind | None = None,
) -> Estimator:
    """Build an estimator by its name in the registry, as its node does.

    ``values`` are the node's parameters where they differ from the defaults; the model is that of
    the package. The method ``oracle``, of no node, is the simulation's true Jacobian. The kind is
    the controller's; by default with the usual parameters.
    """
    kind = kind or simulation.kind
    if method == "oracle":
        return _Oracle(simulation, kind)
    load = partial(_load, simulation.world.joint_names, kind)
    return create_estimator(method, values, load, kind)


class _Oracle(Estimator):
    """The true Jacobian of a simulation: the reference for all estimates."""

    learns = False

    def __init__(self, simulation: Simulation, kind: Kind) -> None:
        super().__init__(kind)
        self._simulation = simulation

    def jacobian(self, joints_rad: np.ndarray, z: np.ndarray | None = None) -> np.ndarray:
        """The true Jacobian, m/rad, shape (d, n)."""
        return self._simulation.true_jacobian(joints_rad, self.kind)


class ClosedLoop(Servo):
    """A servo whose arm and camera are simulated, one joint state after the other.

    Parameters
    ----------
    simulation : Simulation
        Freshly reset.
    estimator : Estimator
        Learns and gives the Jacobian.
    controller_values : mapping, optional
        The controller node's parameters, where they differ from the defaults; ``autostart`` is on,
        joints and their limits are the simulated arm's.
    """

    def __init__(
        self,
        simulation: Simulation,
        estimator: Estimator,
        controller_values: Mapping[str, Any] | None = None,
    ) -> None:
        self.simulation, config = simulation, simulation.config
        joints = {joint.name: joint for joint in simulation.world.joints}
        arm = {"joint_names": list(joints), "command_interface": config.command_interface}
        super().__init__(estimator, {**arm, **(controller_values or {})}, joints)
        self.period_s = 1.0 / config.joint_state_rate_hz

    @classmethod
    def of_scheme(
        cls, scheme: Scheme | str, simulation: Simulation | None = None, **controller_values: Any
    ) -> ClosedLoop:
        """Build the loop with a scheme, such as ``best``, and a simulation (default: a UR5).

        Further keyword arguments are parameters of the controller node.
        """
        chosen, simulation = scheme_called(scheme), simulation or Simulation()
        values = {"law": chosen.law, **chosen.controller_values, **controller_values}
        kind = KindConfig.from_values({**simulation.kind.values, **values}).kind
        estimator = make_estimator(chosen.method, simulation, chosen.estimator_values, kind=kind)
        return cls(simulation, estimator, values)

    @property
    def true_feature(self) -> np.ndarray:
        """The feature as it truly is, camera frame, (m,); of several cameras, one by one."""
        return self.simulation.true_feature()

    def tick(self) -> Command:
        """Advance by one joint-state period and tick the controller; returns its command."""
        out = self.simulation.advance()
        for image in out.observations:
            self.see(image.stamp_s, image.z, image.number)
            self.see_object(image.stamp_s, image.object_z)
        self.observe(out.time_s, out.joints_rad)
        values = self.command(self.period_s)
        refusal = None if values is None else self.simulation.command(values)
        assert refusal is None, refusal
        return self.status

    def run(self, seconds: float) -> None:
        """Let time pass."""
        for _ in range(round(seconds / self.period_s)):
            self.tick()
