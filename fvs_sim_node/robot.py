"""The URDF of the robot that is simulated."""

from __future__ import annotations

import re
from pathlib import Path

from fvs_ros.paths import find_file

#: Matches the name of a link or joint in a URDF.
_NAMED = re.compile(r'(<(?:link|joint|parent|child|mimic)\b[^>]*?\b(?:name|link|joint)=")')


def urdf_file(urdf_path: str = "") -> Path:
    """The file of a robot, or of the package's UR5; a ``ValueError`` if there is none."""
    path = Path(urdf_path) if urdf_path else find_file("robots/ur5.urdf")
    if not path.is_file():
        raise ValueError(f"urdf_path: there is no file {urdf_path}")
    return path


def robot_description(urdf_path: str = "", tf_prefix: str = "") -> str:
    """The text of a robot's URDF, with a prefix before each joint and link, as UR's driver does."""
    return _NAMED.sub(rf"\g<1>{tf_prefix}", urdf_file(urdf_path).read_text("utf-8"))
