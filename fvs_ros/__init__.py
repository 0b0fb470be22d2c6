"""Uncalibrated visual servoing of a robot arm.

The closed loop without ROS: :class:`~fvs_tools.closed_loop.ClosedLoop` joins a
:class:`~fvs_sim_node.simulation.Simulation`, an estimator and a controller as the nodes do.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

#: The package's face: what a researcher needs, and where it lives. Looked up when asked for, since
#: the ground imports nothing from above.
_FACE = {
    "ClosedLoop": "fvs_tools.closed_loop",
    "ControlInput": "fvs_controller_node.base",
    "ControlLaw": "fvs_controller_node.base",
    "ControlOutput": "fvs_controller_node.base",
    "EstimationLoop": "fvs_estimator_node.loop",
    "Estimator": "fvs_estimator_node.base",
    "MotionStep": "fvs_estimator_node.base",
    "Servo": "fvs_tools.servo",
    "ServoClient": "fvs_tools.client_node",
    "ServoLoop": "fvs_controller_node.loop",
    "SimConfig": "fvs_sim_node.simulation",
    "Simulation": "fvs_sim_node.simulation",
}
__all__ = sorted(_FACE)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    if name not in _FACE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_FACE[name]), name)
