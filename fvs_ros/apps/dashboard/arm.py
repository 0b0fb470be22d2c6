"""The robot's model as its driver tells it: where its links are."""

from __future__ import annotations

import io
import logging
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yourdfpy

_PACKAGE = "package://"


class Arm:
    """A robot read from URDF.

    Parameters
    ----------
    text : str
        The URDF.
    names : sequence of str
        Its six joints in kinematic order, as the URDF calls them.
    tf_prefix : str
        What stands before the names of its links.

    Raises
    ------
    ValueError
        If it is no URDF, or has no such joints.
    """

    def __init__(self, text: str, names: Sequence[str], tf_prefix: str = "") -> None:
        self.names = tuple(names)
        self.urdf = _load(text)
        missing = [name for name in names if name not in self.urdf.joint_map]
        if missing:
            raise ValueError(f"robot_description has no joint {', '.join(missing)}")
        links = self.urdf.link_map
        flange, base = f"{tf_prefix}tool0", f"{tf_prefix}base_link"
        self._flange = flange if flange in links else self.urdf.joint_map[names[-1]].child
        self._base = base if base in links else self.urdf.base_link

    def configuration(self, joints_rad: np.ndarray) -> dict[str, float]:
        """Joint positions by name, of positions in kinematic order, rad, shape (6,)."""
        return {name: float(angle) for name, angle in zip(self.names, joints_rad, strict=True)}

    def flange(self, joints_rad: np.ndarray) -> np.ndarray:
        """Pose of the flange in ``base_link``, shape (4, 4), m."""
        self.urdf.update_cfg(self.configuration(joints_rad))
        return self.urdf.get_transform(self._flange, self._base)

    @property
    def base(self) -> np.ndarray:
        """Pose of ``base_link`` in the model's root, shape (4, 4), m."""
        return self.urdf.get_transform(self._base)


def _load(text: str) -> yourdfpy.URDF:
    # It warns of what every robot's URDF has, and of meshes that are not here.
    logging.getLogger("yourdfpy").setLevel(logging.ERROR)
    try:
        return yourdfpy.URDF.load(
            io.BytesIO(text.encode("utf-8")), filename_handler=_find, force_mesh=False
        )
    except Exception as error:  # whatever its XML and mesh readers raise
        raise ValueError(f"robot_description cannot be read: {error}") from error


def _find(fname: str) -> str:
    """The file of a mesh that the URDF names."""
    if not fname.startswith(_PACKAGE):
        return fname.removeprefix("file://")
    package, _, rest = fname.removeprefix(_PACKAGE).partition("/")
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        path = Path(prefix, "share", package, rest)
        if path.is_file():
            return str(path)
    return rest
