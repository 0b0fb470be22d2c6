"""Tags, alone or several on one body: their numbers, sizes and places."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from functools import cached_property

import cv2
import numpy as np

from fvs_ros.kinds import KINDS, MountConfig
from fvs_ros.kinds.ball import Ball
from fvs_ros.kinds.kind import ON_ARM
from fvs_ros.kinds.points import Points
from fvs_ros.kinds.pose import Pose
from fvs_ros.params import Parameters, parameter
from fvs_ros.rotations import rotation_from_vector

#: Dictionaries of OpenCV, without its prefix; of two spellings, H and h, the latter.
_NAMES = {number: name for name, number in sorted(vars(cv2.aruco).items()) if name[:5] == "DICT_"}
DICTIONARIES = tuple(sorted(name.removeprefix("DICT_") for name in _NAMES.values()))
#: Where the tags are on the flat print, to the right and up, in widths of a tag with its border.
#: The sides of a cube are then folded back.
LAYOUTS = {
    "single": ((0.0, 0.0),),
    "plate": ((-0.5, 0.5), (0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)),
    "cube": ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)),
}

#: Corners of a square whose sides are 1, clockwise from the upper left.
SQUARE = 0.5 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])


@dataclass(frozen=True)
class Face:
    """One tag of a layout, in the frame of the whole."""

    middle_m: np.ndarray  # (3,)
    rotation: np.ndarray  # from the tag's frame to that of the whole, (3, 3)
    corners_m: np.ndarray  # of the black square, clockwise from the upper left, (4, 3)


@dataclass(frozen=True)
class Tag(Parameters):
    """The tag, or the tags of one body, that are looked for."""

    tag_dictionary: str = parameter(
        "APRILTAG_36h11", "family of the tag, as OpenCV names it", choices=DICTIONARIES
    )
    tag_id: int = parameter(0, "number of the tag; the others of a layout follow", 0, 2**16 - 1)
    tag_size_m: float = parameter(
        0.1, "side of the tag's black square; measure it: the distance scales with it", 0.005, 1.0
    )
    tag_layout: str = parameter(
        "single",
        "single, or several tags on one body, as fvs_tag prints them: plate (2 x 2) or cube (front "
        "and four sides)",
        choices=tuple(LAYOUTS),
    )

    @property
    def dictionary(self) -> cv2.aruco.Dictionary:
        """The family, as OpenCV has it."""
        if not hasattr(cv2.aruco, "ArucoDetector"):
            raise ValueError(
                f"tags need OpenCV 4.7 or newer, this is {cv2.__version__}: "
                "pip install 'opencv-python-headless<4.12'"
            )
        name = f"DICT_{self.tag_dictionary}"
        family = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
        if distance := re.search(r"(?<=h)\d+$", name, re.IGNORECASE):
            # Of AprilTags OpenCV before 4.14 corrects no bit: a reflection hides the tag.
            family.maxCorrectionBits = (int(distance[0]) - 1) // 2
        return family

    @property
    def cells(self) -> int:
        """Cells along a side of the black square."""
        return int(self.dictionary.markerSize) + 2

    @property
    def pitch_m(self) -> float:
        """Width of a tag with its white border of one cell, m."""
        return self.tag_size_m * (self.cells + 2) / self.cells

    @property
    def extent_m(self) -> np.ndarray:
        """Width, height and depth of the body, m, (3,); a plate is flat."""
        edges = {"single": (1.0, 1.0, 0.0), "plate": (2.0, 2.0, 0.0), "cube": (1.0, 1.0, 1.0)}
        return self.pitch_m * np.array(edges[self.tag_layout])

    @cached_property
    def faces(self) -> dict[int, Face]:
        """The tags by their numbers.

        The frame of the whole has its origin in the middle, x to the right of the first tag, y up
        and z out of its print.
        """
        faces, square_m = {}, self.tag_size_m * SQUARE
        for number, (x, y) in enumerate(LAYOUTS[self.tag_layout], self.tag_id):
            rotation, middle_m = np.eye(3), self.pitch_m * np.array([x, y, 0.0])
            if self.tag_layout == "cube":
                rotation = rotation_from_vector(0.5 * np.pi * np.array([-y, x, 0.0]))
                middle_m = 0.5 * self.pitch_m * rotation[:, 2]
            faces[number] = Face(middle_m, rotation, middle_m + square_m @ rotation.T)
        return faces

    def facing(self, rotation: np.ndarray, position_m: np.ndarray) -> list[int]:
        """Numbers of the tags whose print looks at the camera, from a pose in its frame."""
        return [
            number
            for number, face in self.faces.items()
            if (rotation @ face.rotation[:, 2]) @ (position_m + rotation @ face.middle_m) < 0.0
        ]


@dataclass(frozen=True)
class TagsConfig(MountConfig):
    """What is seen, its tags, and those of the object that the tool may be seen from."""

    feature: str = parameter(
        MountConfig.feature,
        "ball, pose of a tag, or points, px: the ball's centre, or all corners of the tags",
        choices=tuple(KINDS),
    )
    ball, pose = Ball(), Pose()
    points: Points = field(default_factory=Points)
    tag: Tag = field(default_factory=Tag)
    object_tag_id: int = parameter(
        -1,
        "number of the object's tag, the others of its layout follow; -1: no object, or, seen by a "
        "camera on the arm, that of tag_id",
        -1,
        2**16 - 1,
    )
    object_tag_size_m: float = parameter(
        0.08, "side of the black square of the object's tag; measure it", 0.005, 1.0
    )
    object_tag_layout: str = parameter(
        "plate", "like tag_layout, of the object", choices=tuple(LAYOUTS)
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.camera_mount == ON_ARM:
            object.__setattr__(self, "tag", self.object_tag or self.tag)
            object.__setattr__(self, "object_tag_id", -1)

    @property
    def carries(self) -> str:
        """The kind of body that is seen, by the feature that it usually has; empty: any other."""
        if self.kind.rigid:
            return self.feature
        corners = 4 * len(self.tag.faces)
        return {1: "ball", corners: "pose"}.get(self.points.point_count, "")

    @property
    def object_tag(self) -> Tag | None:
        """The object's tags, of the tool's dictionary; None without an object."""
        if self.object_tag_id < 0:
            return None
        return replace(
            self.tag,
            tag_id=self.object_tag_id,
            tag_size_m=self.object_tag_size_m,
            tag_layout=self.object_tag_layout,
        )
