"""The whole loop without ROS: simulated arm and camera, estimator and controller in lock step.

It connects the same objects as the nodes, and steps them one joint state at a time. A run is a
bit-exact function of its configuration and seed.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache, partial
from typing import Any

import numpy as np

from fvs_controller_node.config import default_values
from fvs_controller_node.inbox import JACOBIAN
from fvs_controller_node.loop import ServoLoop
from fvs_controller_node.supervisor import Command
from fvs_estimator_node.base import Estimator
from fvs_estimator_node.files import TrainedModel, load_model
from fvs_estimator_node.loop import EstimationLoop
from fvs_estimator_node.registry import create_estimator
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.interface import POSITION, PositionPath
from fvs_ros.kinds import Kind, KindConfig
from fvs_ros.limits import with_urdf_limits
from fvs_ros.paths import find_file
from fvs_sim_node.simulation import Simulation
from fvs_tools.schemes import Scheme
from fvs_tools.schemes import scheme as scheme_called


@lru_cache(maxsize=4)
def _load(name: str, joint_names: tuple[str, ...], kind: Kind) -> TrainedModel:
    own: dict[str, Any] = {"feature": kind.name, kind.name: kind}
    return load_model(
        find_file(name), joint_names, KindConfig(camera_mount=kind.camera_mount, **own)
    )


def _seen(simulation: Simulation) -> dict[str, Any]:
    """Parameters of what is servoed."""
    config, points = simulation.config, simulation.config.points
    own = {each.name: getattr(points, each.name) for each in points.declared()}
    return {"feature": config.feature, "camera_mount": config.camera_mount, **own}


def make_estimator(
    method: str,
    simulation: Simulation,
    values: Mapping[str, Any] | None = None,
    model: str = "",
    kind: Kind | None = None,
) -> Estimator:
    """Build an estimator by its name in the registry, as its node does.

    ``values`` are the node's parameters where they differ from the defaults, ``model`` is a file or
    a name in the project's ``config`` folder; empty: that of the package. The method
    ``oracle``, of no node, is the simulation's true Jacobian. The kind is the controller's; by
    default with the usual parameters.
    """
    kind = kind or simulation.kind
    if method == "oracle":
        return _Oracle(simulation, kind)
    names = simulation.world.joint_names
    load = partial(_load, model or kind.model, names, kind)
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


class ClosedLoop:
    """Simulation, estimator and controller, one joint state after the other.

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
        self.simulation = simulation
        self.estimator = estimator
        joints = {joint.name: joint for joint in simulation.world.joints}
        own = {"autostart": True, "joint_names": list(joints), **(controller_values or {})}
        own |= _seen(simulation)
        self.loop = ServoLoop(with_urdf_limits(default_values(**own), joints))
        self.kind = self.loop.kind
        self.estimation = EstimationLoop(estimator)
        self._path = PositionPath()
        self.period_s = 1.0 / simulation.config.joint_state_rate_hz

    @classmethod
    def of_scheme(
        cls, scheme: Scheme | str, simulation: Simulation | None = None, **controller_values: Any
    ) -> ClosedLoop:
        """Build the loop with a scheme, such as ``best``, and a simulation (default: a UR5).

        Further keyword arguments are parameters of the controller node.
        """
        chosen = scheme_called(scheme) if isinstance(scheme, str) else scheme
        simulation = simulation or Simulation()
        values = {"law": chosen.law, **chosen.controller_values, **controller_values}
        kind = KindConfig.from_values({**values, **_seen(simulation)}).kind
        estimator = make_estimator(chosen.method, simulation, chosen.estimator_values, kind=kind)
        return cls(simulation, estimator, values)

    @property
    def true_feature(self) -> np.ndarray:
        """The feature as it truly is, camera frame, (m,); of several cameras, one by one."""
        return self.simulation.true_feature()

    def tick(self) -> Command:
        """Advance by one joint-state period and tick the controller; returns its command."""
        out = self.simulation.advance()
        now_s = out.time_s
        for image in out.observations:
            if image.z is not None:
                self.estimation.add_image(image.stamp_s, image.z, image.number)
                self.loop.add_image(now_s, image.stamp_s, image.z, image.number)
            if image.object_z is not None:
                self.loop.add_object(now_s, image.stamp_s, image.object_z)
        self.estimation.add_joints(now_s, out.joints_rad)
        problem, chain = self.estimation.problem, self.estimator.chain
        if not problem:
            self.loop.add_jacobian(now_s, self.estimation.jacobian(out.joints_rad))
        if chain is not None:
            self.loop.add_chain(now_s, chain)
        self.loop.supervisor.inputs[JACOBIAN].set_source_status(now_s, problem)
        self.loop.add_joints(now_s, now_s, out.joints_rad)
        command = self.loop.tick(now_s, self.period_s)
        if self.loop.sliding_variable is not None:
            self.estimation.add_sliding_variable(now_s, self.loop.sliding_variable)
        values = command.velocity_rad_s
        if self.simulation.config.command_interface == POSITION:
            limits = self.loop.supervisor.config
            values = self._path.advance(values, out.joints_rad, self.period_s, limits)
        refusal = self.simulation.command(values)
        assert refusal is None, refusal
        return command

    def run(self, seconds: float) -> None:
        """Let time pass."""
        for _ in range(round(seconds / self.period_s)):
            self.tick()

    def set_target(self, target: np.ndarray) -> None:
        """Give the controller a target, camera frame, (m,).

        Raises
        ------
        ValueError
            If the controller refuses it; the text says why.
        """
        accepted, text = self.loop.add_target(
            np.asarray(target, dtype=float), CAMERA_FRAME, self.simulation.time_s
        )
        if not accepted:
            raise ValueError(text)
