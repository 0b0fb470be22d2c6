"""What a URDF says of an arm's joints: their order and their limits."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, isfinite

_MOVING = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True)
class UrdfJoint:
    """A joint; its limits in rad and rad/s, of a prismatic one in m and m/s, infinite for none."""

    name: str
    kind: str
    parent: str
    child: str
    lower: float
    upper: float
    velocity: float

    @property
    def moves(self) -> bool:
        """Whether it is no fixed joint, and not one that mimics another."""
        return self.kind in _MOVING


def read_joints(text: str) -> dict[str, UrdfJoint]:
    """All joints of a URDF, by name; a ``ValueError`` if it is none."""
    if "<!DOCTYPE" in text:  # a few lines of one can expand beyond any memory
        raise ValueError("the URDF has a DOCTYPE, which is not taken")
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise ValueError(f"the URDF is no XML: {error}") from None
    if root.tag != "robot":
        raise ValueError(f"a URDF has one <robot>, got <{root.tag[:40]}>")
    return {one.name: one for one in map(_joint, root.findall("joint"))}


def _joint(element: ET.Element) -> UrdfJoint:
    name, kind = element.get("name", ""), element.get("type", "")
    limit = element.find("limit")
    given: Mapping[str, str] = {} if limit is None else limit.attrib
    try:
        lower, upper = (float(given.get(end, "0")) for end in ("lower", "upper"))
        velocity = float(given.get("velocity", "0"))
        ends = {one.tag: one.attrib["link"] for one in element if one.tag in ("parent", "child")}
        parent, child = ends["parent"], ends["child"]
    except (ValueError, KeyError):
        words = f"joint {name[:60]!r} of the URDF lacks a link or has a bad limit"
        raise ValueError(words) from None
    if lower > upper:
        raise ValueError(f"joint {name[:60]!r} of the URDF has limits {lower:g} to {upper:g}")
    if kind == "continuous" or lower == upper:
        lower, upper = -inf, inf
    if element.find("mimic") is not None:
        kind = "mimic"
    velocity = velocity if isfinite(velocity) and velocity > 0.0 else inf
    return UrdfJoint(name, kind, parent, child, lower, upper, velocity)


def moving_chain(joints: Mapping[str, UrdfJoint], link: str = "") -> tuple[str, list[UrdfJoint]]:
    """A link, and the moving joints from the root to it.

    Without one it is ``tool0``, or else the link with most moving joints before it.
    """
    above = {one.child: one for one in joints.values()}

    def chain(end: str) -> list[UrdfJoint]:
        found: list[UrdfJoint] = []
        while end in above and len(found) < len(above):
            found.insert(0, above[end])
            end = above[end].parent
        return [one for one in found if one.moves]

    end = link or ("tool0" if "tool0" in above else "")
    end = end or max(above, key=lambda one: len(chain(one)), default="")
    if end not in above:
        known = ", ".join(sorted(above))[:400]
        raise ValueError(f"no joint of the URDF has the link {end!r} after it; there are {known}")
    moving = chain(end)
    if not moving:
        raise ValueError(f"no moving joint of the URDF carries {end}")
    return end, moving
