"""The robot's model as its driver tells it: where its links are."""

from __future__ import annotations

import io
import logging
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh
import yourdfpy

_PACKAGE = "package://"
#: Where ROS is installed, if it is: programs that sourced none find its meshes, too.
_INSTALLED = Path("/opt/ros")
#: How thick a bar is, m, and its colour; a link that is shorter gets none.
_BAR_RADIUS_M, _SHORTEST_M = 0.03, 1e-3
_BAR_COLOUR = (204, 209, 217, 255)


class Arm:
    """A robot read from URDF.

    Parameters
    ----------
    text : str
        The URDF.
    names : sequence of str
        Its n joints in kinematic order, as the URDF calls them.
    tf_prefix : str
        What stands before the names of its links.

    Attributes
    ----------
    urdf : yourdfpy.URDF
        The model; where a link of the arm has no shape that can be had, a bar to its next joint.
    missing : str
        Which shapes could not be had, and what to do, in a sentence; empty where all are there.

    Raises
    ------
    ValueError
        If it is no URDF, or has no such joints.
    """

    def __init__(self, text: str, names: Sequence[str], tf_prefix: str = "") -> None:
        self.names = tuple(names)
        self.urdf, self.missing = _load(text)
        unknown = [name for name in names if name not in self.urdf.joint_map]
        if unknown:
            raise ValueError(f"robot_description has no joint {', '.join(unknown)}")
        links = self.urdf.link_map
        flange, base = f"{tf_prefix}tool0", f"{tf_prefix}base_link"
        self._flange = flange if flange in links else self.urdf.joint_map[names[-1]].child
        self._base = base if base in links else self.urdf.base_link
        self._add_bars()

    def configuration(self, joints_rad: np.ndarray) -> dict[str, float]:
        """Joint positions by name, of positions in kinematic order, rad, shape (n,)."""
        return {name: float(angle) for name, angle in zip(self.names, joints_rad, strict=True)}

    def flange(self, joints_rad: np.ndarray) -> np.ndarray:
        """Pose of the flange in ``base_link``, shape (4, 4), m."""
        self.urdf.update_cfg(self.configuration(joints_rad))
        return self.urdf.get_transform(self._flange, self._base)

    @property
    def base(self) -> np.ndarray:
        """Pose of ``base_link`` in the model's root, shape (4, 4), m."""
        return self.urdf.get_transform(self._base)

    def _add_bars(self) -> None:
        """Draw a bar to the next joint for each link of the arm that has no shape here."""
        scene = self.urdf.scene
        drawn = {scene.graph.transforms.parents[name] for name in scene.graph.nodes_geometry}
        by_child = {joint.child: joint for joint in self.urdf.joint_map.values()}
        first, link = self.urdf.joint_map[self.names[0]].parent, self._flange
        while link != first and link in by_child:
            joint = by_child[link]
            link = joint.parent
            end_m = np.zeros(3) if joint.origin is None else joint.origin[:3, 3]
            if link in drawn or np.linalg.norm(end_m) < _SHORTEST_M:
                continue
            bar = trimesh.creation.cylinder(
                _BAR_RADIUS_M, segment=[np.zeros(3), end_m], sections=24
            ) + trimesh.creation.icosphere(2, 1.3 * _BAR_RADIUS_M).apply_translation(end_m)
            bar.visual.face_colors = _BAR_COLOUR
            name = f"{link}_bar"
            scene.add_geometry(bar, name, geom_name=name, parent_node_name=link)


def _load(text: str) -> tuple[yourdfpy.URDF, str]:
    """Read a URDF with its meshes, as far as they can be had, and a sentence about the others."""
    # It warns of what every robot's URDF has, and of meshes that are not here.
    logging.getLogger("yourdfpy").setLevel(logging.ERROR)
    lost: list[str] = []

    def find(fname: str) -> str:
        path = _find(fname)
        if not Path(path).is_file():
            lost.append(fname)
        return path

    def load(meshes: bool) -> yourdfpy.URDF:
        source = io.BytesIO(text.encode("utf-8"))
        return yourdfpy.URDF.load(source, filename_handler=find, load_meshes=meshes)

    # Whatever its XML and mesh readers raise.
    try:
        return load(True), _about(lost)
    except Exception as error:
        try:
            return load(False), f"bars are drawn, for a mesh cannot be read: {error}"
        except Exception:
            raise ValueError(f"robot_description cannot be read: {error}") from error


def _about(lost: Sequence[str]) -> str:
    """What to say of meshes that are not here."""
    if not lost:
        return ""
    packages = {name.removeprefix(_PACKAGE).partition("/")[0] for name in lost if _PACKAGE in name}
    said = f"{len(set(lost))} meshes are not on this computer ({lost[0]}): bars are drawn instead"
    if not packages:
        return said
    debian = " ".join(f"ros-jazzy-{name.replace('_', '-')}" for name in sorted(packages))
    return (
        f"{said}; install {debian} (apt), or name the folder that holds "
        f"share/{min(packages)} in AMENT_PREFIX_PATH, and start this again"
    )


def _find(fname: str) -> str:
    """The file of a mesh that the URDF names."""
    if not fname.startswith(_PACKAGE):
        return fname.removeprefix("file://")
    inside = fname.removeprefix(_PACKAGE)
    sourced = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    prefixes = (*map(Path, filter(None, sourced)), *sorted(_INSTALLED.glob("*"), reverse=True))
    paths = (prefix / "share" / inside for prefix in prefixes)
    return str(next((path for path in paths if path.is_file()), inside))
