"""Kinds of features. A new one is a file here and a line in ``KINDS``."""

from __future__ import annotations

from dataclasses import dataclass

from fvs_ros.camera import FeatureConfig
from fvs_ros.kinds.ball import Ball
from fvs_ros.kinds.kind import ErrorText, Kind
from fvs_ros.kinds.pose import Pose
from fvs_ros.params import parameter

__all__ = ["KINDS", "ErrorText", "Kind", "KindConfig", "kind_of"]

#: By the value of the parameter ``feature``.
KINDS: dict[str, type[Kind]] = {"ball": Ball, "pose": Pose}


@dataclass(frozen=True)
class KindConfig(FeatureConfig):
    """What is servoed."""

    feature: str = parameter(
        "ball", "what is servoed: a ball, or the pose of a tag", choices=tuple(KINDS)
    )
    lever_arm_m: float = parameter(
        0.3,
        "Lever arm: converts rotation to length, m per rad; for pose. Limits and gains of lengths "
        "then hold for rotation, too.",
        0.1,
        1.0,
    )

    @property
    def kind(self) -> Kind:
        """The kind of feature."""
        return kind_of(self.feature, self.lever_arm_m)


def kind_of(feature: str, lever_arm_m: float = KindConfig.lever_arm_m) -> Kind:
    """The kind with a name."""
    return KINDS[feature](lever_arm_m)
