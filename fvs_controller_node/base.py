"""The interface of a control law: what it is told at a tick, and what it answers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from fvs_ros.chain import SerialChain
from fvs_ros.joints import N_JOINTS
from fvs_ros.params import Parameter

N_AXES = 3

#: Joint velocities of an arm that rests, rad/s.
AT_REST = np.zeros(N_JOINTS)
AT_REST.flags.writeable = False


class ControlInput(NamedTuple):
    """What a law knows at one tick.

    Parameters
    ----------
    error_m : ndarray, shape (3,)
        Ball position, predicted to now, minus its target; camera frame, m.
    jacobian : ndarray, shape (3, 6)
        Estimated Jacobian at the present joints, m/rad.
    applied_rad_s : ndarray, shape (6,)
        Joint velocities actually sent at the last tick, after every limit, rad/s.
    joints_rad : ndarray, shape (6,)
        Joint positions, rad.
    dt_s : float
        Time since the last tick, s; positive.
    news : int
        Changes whenever something else than the joints' motion and ``ahead_rad_s`` has changed
        ``error_m``: an image, a target that was told.
    chain : SerialChain, optional
        Forward model of arm and ball as the camera sees them; up to a constant offset.
    home_rad : ndarray, shape (6,), optional
        Joints at which the arm was started, rad: a posture to come back to on the way.
    ahead_rad_s : ndarray, shape (6,)
        Joint velocities that go along with a moving target, rad/s: added to what the law answers.
    targets : int
        Changes with every target that ``ahead_rad_s`` has not led to.
    """

    error_m: np.ndarray
    jacobian: np.ndarray
    applied_rad_s: np.ndarray
    joints_rad: np.ndarray
    dt_s: float
    news: int = 0
    chain: SerialChain | None = None
    home_rad: np.ndarray | None = None
    ahead_rad_s: np.ndarray = AT_REST
    targets: int = 0


class ControlOutput(NamedTuple):
    """What a law answers.

    Parameters
    ----------
    velocity_rad_s : ndarray, shape (6,)
        Wanted joint velocities before any limit, rad/s.
    sliding_variable : ndarray, shape (3,)
        What the law gives the estimator's update law in the place of s: a sliding mode law its
        sliding variable (17), the proportional law the error (45); zeros for a law without one.
    exponent : ndarray, shape (3,)
        The exponent gamma of each axis; ones for a law without one.
    brakes : bool
        Whether the law itself brakes in time for the target; else the supervisor sees to it.
    feed_forward_rad_s : float
        Speed of the fastest joint that only keeps up with a moving target, rad/s.
    """

    velocity_rad_s: np.ndarray
    sliding_variable: np.ndarray
    exponent: np.ndarray
    brakes: bool = False
    feed_forward_rad_s: float = 0.0


class ControlLaw(ABC):
    """Turns an error and a Jacobian into joint velocities.

    A law declares its own parameters and builds itself from their values, so that a new law
    is one file here and one line in :mod:`fvs_controller_node.registry`.
    """

    #: Whether it makes use of a chain; else nobody minds what becomes of chains.
    reads_chain: ClassVar[bool] = False

    #: Whether it moves at the least joint speeds, whatever the parameter ``allocation`` says.
    least_speed: ClassVar[bool] = False

    #: Parameters that this law adds to the node's.
    PARAMETERS: ClassVar[tuple[Parameter, ...]] = ()

    @classmethod
    @abstractmethod
    def from_values(cls, values: Mapping[str, Any]) -> ControlLaw:
        """Build the law with the gains in ``values`` (by parameter name)."""

    @abstractmethod
    def command(self, control_input: ControlInput) -> ControlOutput:
        """Return the joint velocities for this tick, before any limit."""

    def settling_bound_s(self, error_m: np.ndarray) -> float | None:
        """Longest time from rest at an error, m, shape (3,), to zero, without speed limits, s.

        None for a law that makes no such promise.
        """
        return None

    def reset(self) -> None:  # noqa: B027  (a law without memory has nothing to forget)
        """Forget the past: called at every tick that does not servo."""
