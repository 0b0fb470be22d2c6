"""The interface of a control law: its input and its output at a tick."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from enum import Enum
from typing import Any, ClassVar, NamedTuple

import numpy as np

from fvs_controller_node.redundancy import make_inverse
from fvs_ros.kinds import Kind
from fvs_ros.kinds.ball import Ball
from fvs_ros.params import Parameters
from fvs_ros.pixel_chain import AnyChain


class Change(Enum):
    """What changed the error since the last tick, apart from joint and target motion."""

    NOTHING = 0
    MEASUREMENT = 1  #: an image, or an update of a moving target
    TARGET = 2  #: another target


class ControlInput(NamedTuple):
    """The input of a law at one tick, for a task of d components and n joints."""

    #: Feature, predicted to now, from its target; camera frame, m, (d,).
    error_m: np.ndarray
    #: Of the task, estimated at the present joints, m/rad, (d, n).
    jacobian: np.ndarray
    #: Command sent at the last tick, after every limit, without the feed-forward, (n,).
    applied_rad_s: np.ndarray
    #: Joint positions, (n,).
    joints_rad: np.ndarray
    #: Time since the last tick; positive.
    dt_s: float
    #: Joints at the last start, (n,): the posture that redundancy resolution returns to.
    home_rad: np.ndarray | None = None
    #: Forward model of arm and feature as the camera sees them; up to a constant offset.
    chain: AnyChain | None = None
    #: What has changed ``error_m``.
    change: Change = Change.NOTHING
    #: Joint velocities that follow a moving target, (n,): added to the law's output.
    feed_forward_rad_s: np.ndarray | None = None
    #: What is servoed.
    kind: Kind = Ball()


class ControlOutput(NamedTuple):
    """The output of a law."""

    #: Wanted joint velocities before any limit, (n,).
    velocity_rad_s: np.ndarray
    #: The s of the estimator's update law, (d,): the sliding variable in (17), the error in (45)
    #: for the proportional law; zeros for a law without one.
    sliding_variable: np.ndarray
    #: The exponent gamma of each component, (d,); ones for a law without one.
    exponent: np.ndarray

    @classmethod
    def plain(cls, velocity_rad_s: np.ndarray, size: int) -> ControlOutput:
        """Joint velocities of a law without sliding variable and exponent."""
        return cls(velocity_rad_s, np.zeros(size), np.ones(size))


class ControlLaw(ABC):
    """Turns an error and a Jacobian into joint velocities.

    A new law is one file here and one line in :mod:`fvs_controller_node.config`, or an entry point
    ``fvs_ros.laws`` of another package (``examples/04_your_own_law.py``). ``gains`` are its
    parameters, a ``Gains``, ``inverse`` leads from feature velocity to joint velocities.
    """

    #: Whether the law brakes for the target itself. It then uses a chain where there is one, and
    #: always the least joint speeds, whatever ``redundancy_resolution`` is.
    plans: ClassVar[bool] = False

    #: Parameters that this law adds to the node's.
    Gains: ClassVar[type[Parameters]] = Parameters

    def __init__(self, gains: Any = None, inverse: Any = None) -> None:
        self.gains: Any = gains or self.Gains()
        self.inverse: Any = inverse or make_inverse({}, least_speed=self.plans)

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> ControlLaw:
        """Build the law with the gains in ``values`` (by parameter name)."""
        return cls(cls.Gains.from_values(values), make_inverse(values, least_speed=cls.plans))

    @abstractmethod
    def command(self, state: ControlInput) -> ControlOutput:
        """Return the joint velocities for this tick, before any limit."""

    def reset(self) -> None:  # noqa: B027  (a law without memory has nothing to forget)
        """Forget the past: called at every tick that does not servo."""
