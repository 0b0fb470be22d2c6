"""Robots that can be simulated: where their URDFs are, and what these say of the joints."""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from fvs_ros.arguments import how_to_install
from fvs_ros.paths import find_file, find_mesh
from fvs_ros.urdf import UrdfJoint, moving_chain, read_joints, read_robot
from fvs_sim_node.camera import CAMERAS, RigidPose

#: Home of the UR5: the middle of the box that the shipped networks were trained in, and half its
#: widths, rad, kinematic order.
HOME_JOINTS_RAD = (0.0, -1.35, 1.6, -1.75, -1.57, 0.0)
TRAINING_BOX_RAD = (0.6, 0.5, 0.5, 0.5, 0.5, 0.5)

NEEDS_PYBULLET = f"the simulator needs pybullet: {how_to_install('sim', ['pybullet-arm64'])}"

#: By element of a URDF, what holds the name of a link or joint.
_NAMED = {"link": "name", "joint": "name", "parent": "link", "child": "link", "mimic": "joint"}
#: Packages that ship URDFs, and the folder of their files below the site-packages.
_PACKAGES = {
    "example-robot-data": "cmeel.prefix/share/example-robot-data/robots",
    "pybullet_data": "pybullet_data",
    "rtb-data": "rtbdata/xacro",
}


@dataclass(frozen=True)
class Robot:
    """A robot's URDF, and what no URDF tells; where that is empty, the simulator finds it."""

    #: A file in config/, or ``PACKAGE/path`` of one in an installed package.
    urdf: str
    #: Link that carries the ball; empty: ``tool0``, or the last link.
    ball_link: str = ""
    home_rad: tuple[float, ...] = ()
    cameras: Mapping[str, RigidPose] = field(default_factory=dict)

    @property
    def installed(self) -> bool:
        """Whether its URDF is here."""
        with suppress(ValueError):
            return bool(self.file())
        return False

    def file(self) -> Path:
        """The URDF; a ``ValueError`` says which package to install."""
        package, _, inside = self.urdf.partition("/")
        if package not in _PACKAGES:
            return find_file(self.urdf)
        for folder in sys.path:
            if (path := Path(folder, _PACKAGES[package], inside)).is_file():
                return path
        raise ValueError(f"robot: {inside} is not installed; run pip install {package}")


def _example(path: str, ball_link: str) -> Robot:
    return Robot(f"example-robot-data/{path}", ball_link)


#: By the value of the parameter ``robot``.
ROBOTS = {
    "ur5": Robot("robots/ur5.urdf", "tool0", HOME_JOINTS_RAD, CAMERAS),
    "ur3": _example("ur_description/urdf/ur3_robot.urdf", "tool0"),
    "ur10": _example("ur_description/urdf/ur10_robot.urdf", "tool0"),
    "panda": _example("panda_description/urdf/panda.urdf", "panda_hand_tcp"),
    "xarm7": _example("xarm_description/urdf/xarm7.urdf", "link_eef"),
    "jaco": _example("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector"),
    "so101": Robot("robots/so101.urdf", "tool0"),
    "iiwa": Robot("pybullet_data/kuka_iiwa/model.urdf", "lbr_iiwa_link_7"),
    # The coloured one has red parts.
    "scara": Robot("robots/scara.urdf", "tool0"),
    "al5d": Robot("rtb-data/lynxmotion_al5d_description/urdf/al5d_robot.urdf", "link4"),
    "xarm6": Robot("pybullet_data/xarm/xarm6_robot_white.urdf", "link6"),
}


def robot_of(name: str, urdf_path: str = "", ball_link: str = "") -> Robot:
    """The robot that the simulator's parameters name."""
    if urdf_path:
        if not Path(urdf_path).is_file():
            raise ValueError(f"urdf_path: there is no file {urdf_path}")
        return Robot(urdf_path, ball_link)
    known = ROBOTS[name or "ur5"]
    return replace(known, ball_link=ball_link) if ball_link else known


def moving_joints(robot: Robot) -> tuple[str, list[UrdfJoint]]:
    """The link of its ball, and the joints that move it, base to ball.

    A ``ValueError`` says which file is no URDF of such a robot, and why.
    """
    path = robot.file()
    try:
        return moving_chain(read_joints(path.read_bytes()), robot.ball_link)
    except (ValueError, OSError) as error:
        raise ValueError(f"{path}: {error}") from error


def robot_description(
    robot: Robot, tf_prefix: str = "", say: Callable[[str], None] = lambda words: None
) -> str:
    """The text of its URDF: mesh files absolute, and a prefix before each joint and link.

    ``say`` gets a sentence about meshes that are not here.
    """
    path = robot.file()
    root = read_robot(path.read_bytes())
    for element in root.iter():
        name = _NAMED.get(element.tag, "")
        if name in element.attrib:
            element.set(name, tf_prefix + element.attrib[name])
    if missing := find_meshes(root, path):
        say(missing)
    return ET.tostring(root, encoding="unicode")


def find_meshes(root: ET.Element, urdf: Path | None = None) -> str:
    """Name a URDF's mesh files absolutely; a sentence about those for which cubes stand, if any."""
    missing = set[str]()
    for geometry in root.iter("geometry"):
        for mesh in geometry.findall("mesh"):
            name = mesh.get("filename", "")
            file = find_mesh(name, urdf)
            if file:
                mesh.set("filename", f"file://{file}")
            else:
                missing.add(name)
                geometry.remove(mesh)
                ET.SubElement(geometry, "box", size="0.04 0.04 0.04")
    if not missing:
        return ""
    return (
        f"cubes stand for {len(missing)} meshes that are not here, such as {min(missing)}; install "
        "its package, or name the folder above its share in AMENT_PREFIX_PATH"
    )
