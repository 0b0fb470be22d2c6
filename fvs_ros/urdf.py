"""What a URDF says of an arm's joints: their order, frames and limits."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import inf, isfinite
from typing import NoReturn
from xml.parsers import expat

from fvs_ros.vectors import LARGEST
from fvs_ros.yaml_text import read_yaml

_MOVING = ("revolute", "continuous", "prismatic")
#: A joint of these types is where an arm's base stands on whatever carries it.
_LOOSE = ("floating", "planar")
#: Elements of a robot that the programs here know; others may have prefixes that nothing declares.
_KNOWN = ("link", "joint", "material")
#: Standard names of the link that carries a tool (REP 199).
_TIPS = ("tool0", "flange")
_XACRO = (
    "this is a xacro, not a URDF: expand it by `ros2 run xacro xacro FILE > arm.urdf`, or take "
    "the driver's: `ros2 param get --hide-type /robot_state_publisher robot_description`"
)


@dataclass(frozen=True)
class UrdfJoint:
    """A joint; its limits in rad and rad/s, of a prismatic one in m and m/s, infinite for none."""

    name: str
    kind: str
    parent: str
    child: str
    lower: float = -inf
    upper: float = inf
    velocity: float = inf
    #: Offset and deceleration of the speed that its driver allows near an end, if it tells.
    near_end: tuple[float, float] = (0.0, inf)
    #: Of the joint in its parent's frame, m and rad (roll, pitch, yaw), and its axis in its own.
    xyz_m: tuple[float, ...] = (0.0, 0.0, 0.0)
    rpy_rad: tuple[float, ...] = (0.0, 0.0, 0.0)
    axis: tuple[float, ...] = (1.0, 0.0, 0.0)
    #: Why it cannot be used, in words; empty if it can.
    problem: str = ""

    @property
    def moves(self) -> bool:
        """Whether it is no fixed joint, and not one that mimics another."""
        return self.kind in _MOVING


def read_robot(source: str | bytes) -> ET.Element:
    """The links, joints and materials of a URDF, as text or as the bytes of a file.

    It is read as ROS reads it, so without regard to namespaces, and also as people save it: in
    UTF-16 or Latin-1, with something before or after it, or as ``ros2 param get`` and ``ros2 topic
    echo`` print it. A ``ValueError`` says what else it is.
    """
    text = _decoded(source) if isinstance(source, bytes) else source
    whole = "<" not in text or "</robot>" in text
    # The encoding is known by now, and a comment may stand before the declaration.
    text = re.sub(r"<\?xml\s[^>]*\?>", "", _unquoted(text), count=1)
    builder, parser = ET.TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.StartDoctypeDeclHandler = _refuse_doctype
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        cut = "; it has no </robot>: is it cut off? `ros2 topic echo` needs --full-length"
        raise ValueError(f"the URDF is no XML: {error}{'' if whole else cut}") from None
    root = builder.close()
    if root.tag != "robot":
        raise ValueError(f"a URDF has one <robot>, got <{root.tag[:40]}>")
    parts = (part for joint in root.iter("joint") for part in joint.iter())
    values = " ".join(value for part in parts for value in part.attrib.values())
    if any(element.tag.startswith("xacro:") for element in root) or "${" in values:
        raise ValueError(_XACRO)
    robot = ET.Element("robot", name=root.get("name", ""))
    robot.extend(element for element in root if element.tag in _KNOWN)
    return robot


def _refuse_doctype(name: str, *_: object) -> NoReturn:
    # A few lines of one can expand beyond any memory.
    raise ValueError(f"the URDF has a DOCTYPE ({name[:40]}), which is not taken")


def _decoded(data: bytes) -> str:
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", "replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:  # names and numbers are ASCII; comments may not be
        return data.decode("latin-1")


def _unquoted(text: str) -> str:
    """From the first tag to the last, without the quotes of the YAML around it."""
    start, end = text.find("<"), text.rfind(">") + 1
    quote = text[start - 1 : start]
    if quote and quote in "'\"":
        return str(read_yaml(f"{quote}{text[start:end]}{quote}"))
    return text[start:end]


def read_joints(source: str | bytes | ET.Element) -> dict[str, UrdfJoint]:
    """All joints of a URDF, by name; a ``ValueError`` if it is none, see :func:`read_robot`."""
    robot = source if isinstance(source, ET.Element) else read_robot(source)
    joints: dict[str, UrdfJoint] = {}
    for joint in map(_joint, robot.iter("joint")):
        if joint.name in joints:
            raise ValueError(f"the URDF has two joints {joint.name[:60]!r}")
        joints[joint.name] = joint
    return joints


def _joint(element: ET.Element) -> UrdfJoint:
    name, kind = element.get("name", ""), element.get("type", "")
    ends = [element.find(name) for name in ("parent", "child")]
    parent, child = ("" if end is None else end.get("link", "") for end in ends)
    if not (parent and child):
        raise ValueError(f"joint {name[:60]!r} of the URDF lacks a link")
    if element.find("mimic") is not None:
        kind = "mimic"
    limit = element.find("limit")
    attributes: Mapping[str, str] = {} if limit is None else limit.attrib
    try:
        lower, upper, velocity = (
            float(attributes.get(name, "0")) for name in ("lower", "upper", "velocity")
        )
        xyz_m, rpy_rad = (_triple(element, "origin", which) for which in ("xyz", "rpy"))
        axis = _triple(element, "axis", "xyz", "1 0 0")
        near_end = _near_end(element.find("position_based_velocity_limits"))
    except ValueError:
        problem = f"joint {name[:60]!r} of the URDF has a bad number"
        return UrdfJoint(name, kind, parent, child, problem=problem)
    problem = ""
    if kind == "continuous" or lower == upper:
        lower, upper = -inf, inf
    elif not lower < upper:
        problem = f"joint {name[:60]!r} of the URDF has limits {lower:g} to {upper:g}"
    velocity = velocity if isfinite(velocity) and velocity > 0.0 else inf
    return UrdfJoint(
        name, kind, parent, child, lower, upper, velocity, near_end, xyz_m, rpy_rad, axis, problem
    )


def _near_end(element: ET.Element | None) -> tuple[float, float]:
    """Offset and deceleration of a speed limit that depends on the position, as of an FR3."""
    if element is None:
        return UrdfJoint.near_end
    offset, deceleration = (
        float(element.get(name, "")) for name in ("velocity_offset", "deceleration_limit")
    )
    if not (0.0 <= offset < inf and 0.0 < deceleration < inf):
        raise ValueError
    return offset, deceleration


def _triple(
    element: ET.Element, tag: str, attribute: str, usual: str = "0 0 0"
) -> tuple[float, ...]:
    """Three numbers of a child element; a ``ValueError`` if they are others."""
    child = element.find(tag)
    words = usual if child is None else child.get(attribute, usual)
    x, y, z = (float(word) for word in words.split())
    if not max(abs(x), abs(y), abs(z)) <= LARGEST:
        raise ValueError
    return x, y, z


def path_to(above: Mapping[str, UrdfJoint], end: str) -> list[UrdfJoint]:
    """All joints from the root, or from a loose base, to a link, of the joint before each link."""
    path: list[UrdfJoint] = []
    # A loop of joints has no root.
    while end in above and above[end].kind not in _LOOSE and len(path) < len(above):
        path.append(above[end])
        end = above[end].parent
    return path[::-1]


def _arm(above: Mapping[str, UrdfJoint], known: Collection[str]) -> str:
    """The last link of the longest chain of moving joints, without the fingers of a gripper.

    Fingers are shorter than the arm, and there are two as long at least on one body. A last joint
    that is not among the known ones, if some are, is one as well.
    """
    chains = [[joint for joint in path_to(above, end) if joint.kind != "fixed"] for end in above]
    longest = max(chains, key=lambda chain: sum(joint.moves for joint in chain))
    indices = [index for index, joint in enumerate(longest) if joint.moves]
    for before, index in enumerate(indices):
        rest = len(indices) - before
        fingers = (
            len(chain) >= index + rest and chain[index] != longest[index]
            for chain in chains
            if chain[:index] == longest[:index]
        )
        if before > rest and any(fingers):
            indices = indices[:before]
            break
    moving = [longest[index] for index in indices]
    while known and moving and moving[-1].name not in known:
        moving.pop()
    return moving[-1].child if moving else ""


def moving_chain(
    joints: Mapping[str, UrdfJoint], link: str = "", known: Collection[str] = ()
) -> tuple[str, list[UrdfJoint]]:
    """A link, and the moving joints from the root to it.

    Without one it is ``tool0`` or ``flange``, or else the arm's last link: that with most moving
    joints before it, not counting a gripper's, nor last ones that are not among the known names.
    """
    above = {joint.child: joint for joint in joints.values()}
    if not above:
        raise ValueError("the URDF has no joints: is it a xacro that was not expanded?")
    end = link or next((tip for tip in _TIPS if tip in above), "") or _arm(above, known)
    if link and end not in above:
        tips = ", ".join(sorted(above))[:400]
        raise ValueError(f"no joint of the URDF has the link {end!r} after it; there are {tips}")
    path = path_to(above, end)
    for joint in path:
        if joint.problem:
            raise ValueError(joint.problem)
        if joint.kind not in ("fixed", *_MOVING):
            raise ValueError(
                f"joint {joint.name[:60]!r} before {end} is of the kind {joint.kind[:20]!r}, "
                f"which no chain here follows: name a link before it"
            )
    moving = [joint for joint in path if joint.moves]
    if not moving:
        raise ValueError(f"no moving joint of the URDF carries {end or 'anything'}")
    return end, moving
