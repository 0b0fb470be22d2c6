"""The interface of Jacobian estimators, and the motion step they learn from."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from fvs_ros.filter import Image
from fvs_ros.kinds import Kind
from fvs_ros.kinds.ball import Ball
from fvs_ros.params import Parameters
from fvs_ros.pixel_chain import AnyChain, PixelChain, PixelChains

#: What an estimator is made from: a part of a :class:`~fvs_estimator_node.files.TrainedModel`.
NETWORKS, CHAIN = "model", "chain"


@dataclass(frozen=True)
class MotionStep:
    """Motion of the feature and of the n joints between the same two exposures."""

    stamp_s: float  #: exposure of the second image, s
    dt_s: float  #: time between the two exposures, s, positive
    joints_rad: np.ndarray  #: joints at the middle of the step, where its Jacobian is, rad, (n,)
    d_joints_rad: np.ndarray  #: joint motion, rad, (n,)
    d_feature_m: np.ndarray  #: motion of the feature in the camera frame, m, (d,)
    #: The controller's newest sliding variable s, m, (d,); 0 without a controller.
    sliding_variable: np.ndarray | float = 0.0
    z: np.ndarray | None = None  #: the feature at the end, (m,); not needed of a kind that is flat


class Estimator(ABC):
    """Estimates the d x n Jacobian of the feature with respect to the joints.

    It takes steps and answers with Jacobians; it knows neither topics nor clocks. ``kind`` is the
    kind of feature: m numbers that move in d ways; a ball by default.
    """

    #: Whether :meth:`update` and :meth:`observe` can change anything.
    learns = True
    #: What its first argument is, if it takes one: one of the constants above.
    made_from: ClassVar[str] = ""
    #: Its parameters; a node declares them with the name of their group before each.
    config_type: ClassVar[type[Parameters]] = Parameters
    group: ClassVar[str] = ""

    def __init__(self, kind: Kind | None = None) -> None:
        self.kind = kind or Ball()
        #: How many inputs it learned from, and how many it could not use.
        self.updates = self.refused = 0
        self.each: tuple[Estimator, ...] = (self,)  #: those of each camera

    @classmethod
    def needs(cls, config: Any) -> str:
        """What it cannot be made without, with these parameters; empty for nothing."""
        return cls.made_from

    @property
    def problem(self) -> str:
        """Why there is no estimate yet; empty if there is one."""
        return ""

    @property
    def chain(self) -> AnyChain | None:
        """The serial chain as the camera sees it now; None from an estimator that has none."""
        return None

    @abstractmethod
    def jacobian(self, joints_rad: np.ndarray, z: np.ndarray | None = None) -> np.ndarray:
        """Estimate at joints, rad, (n,), and the feature there, (m,): m/rad, a new array, (d, n).

        Of a kind that is flat, it does not depend on z.
        """

    def observe(self, image: Image, noise_m: float) -> None:  # noqa: B027
        """Take every image that is no outlier, also at rest, before the update.

        ``noise_m`` is the standard deviation of a coordinate of it, as learned so far, m.
        """

    def update(self, step: MotionStep) -> None:  # noqa: B027
        """Learn from one step; a step that is not finite is ignored without an exception."""

    def reset(self) -> None:
        """Forget what was learned online."""
        self.updates = self.refused = 0

    def status_values(self) -> dict[str, float]:
        """Live key numbers of the method by name, with the unit in the name; finite."""
        if not self.learns:
            return {}
        return {"updates": float(self.updates), "refused": float(self.refused)}


class Estimators(Estimator):
    """Those of several cameras, whose rows of the Jacobian do not depend on each other."""

    def __init__(self, each: tuple[Estimator, ...], kind: Kind) -> None:
        super().__init__(kind)
        self.each, self.learns = each, each[0].learns

    @property
    def problem(self) -> str:
        """Why one of them has no estimate yet; empty if all have."""
        return next((each.problem for each in self.each if each.problem), "")

    @property
    def chain(self) -> AnyChain | None:
        """Their chains; None from those that have none."""
        chains = [estimator.chain for estimator in self.each]
        before_webcams = tuple(chain for chain in chains if isinstance(chain, PixelChain))
        return PixelChains(before_webcams) if before_webcams else None

    def jacobian(self, joints_rad: np.ndarray, z: np.ndarray | None = None) -> np.ndarray:
        """Estimate at joints, rad, (n,): m/rad, shape (d, n)."""
        return np.concatenate([estimator.jacobian(joints_rad) for estimator in self.each])

    def reset(self) -> None:
        """Forget what was learned online."""
        for estimator in self.each:
            estimator.reset()

    def status_values(self) -> dict[str, float]:
        """Key numbers of each, with the camera's name before theirs."""
        each = zip(self.kind.cameras, self.each, strict=True)
        return {
            f"{camera}_{name}": value
            for camera, estimator in each
            for name, value in estimator.status_values().items()
        }
