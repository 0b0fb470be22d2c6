"""Kinds of features. A new one is a file here and a line in ``KindParameters``."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

from fvs_ros.camera import FeatureConfig
from fvs_ros.kinds.ball import Ball
from fvs_ros.kinds.kind import FIXED, MOUNTS, ErrorText, Kind
from fvs_ros.kinds.points import Points
from fvs_ros.kinds.pose import Pose
from fvs_ros.params import ParameterError, Parameters, parameter, parts_of

__all__ = ["BODIES", "KINDS", "BodyConfig", "ErrorText", "Kind", "KindConfig", "MountConfig"]


@dataclass(frozen=True)
class KindParameters(FeatureConfig):
    """Each kind with its parameters, by the value of the parameter ``feature``."""

    ball: Ball = field(default_factory=Ball)
    points: Points = field(default_factory=Points)
    pose: Pose = field(default_factory=Pose)


#: By the value of the parameter ``feature``.
KINDS: dict[str, type[Kind]] = parts_of(KindParameters)
#: Those of rigid bodies.
BODIES = tuple(name for name, kind in KINDS.items() if kind.rigid)


@dataclass(frozen=True)
class MountConfig(Parameters):
    """What is servoed, and what carries the camera."""

    feature: str = parameter("ball", "kind of feature that is servoed", choices=tuple(KINDS))
    camera_mount: str = parameter(
        FIXED,
        "where the camera is: fixed in the room, it sees what rides on the arm; or on the arm, it "
        "sees what stands in the room",
        choices=MOUNTS,
    )

    @cached_property
    def kind(self) -> Kind:
        """The kind of feature as this camera sees it; a ``ParameterError`` if it cannot."""
        kind: Kind = getattr(self, self.feature)
        if self.camera_mount != FIXED and not kind.rigid:
            raise ParameterError(f"camera_mount: {kind.name} are seen by a camera in the room")
        return replace(kind, camera_mount=self.camera_mount)


@dataclass(frozen=True)
class KindConfig(MountConfig, KindParameters):
    """What is servoed, with the parameters of its kind."""


@dataclass(frozen=True)
class BodyConfig(KindConfig):
    """What is servoed, where only a rigid body will do."""

    feature: str = parameter(KindConfig.feature, "kind of feature that is servoed", choices=BODIES)
