"""A light UR5 model as URDF text, from the published kinematics.

Link and joint names, joint frames, limits, masses, centres of mass and inertias are those that
Universal Robots publishes in ``ur_description`` (``config/ur5``: default_kinematics.yaml,
joint_limits.yaml, physical_parameters.yaml). The shapes are primitives, which a software renderer
draws several times faster than meshes. No part is reddish: red is the ball's.

The root ``base_link`` is ROS's: the Denavit-Hartenberg ``base`` frame turned by half a turn
about z.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

from fvs_ros.joints import UR_JOINT_NAMES, UR_POSITION_LIMITS_RAD

#: UR5 link lengths a_i, m (Universal Robots, "DH parameters for calculations of kinematics and
#: dynamics"). A row is Rz(q) Tz(d) Tx(a) Rx(alpha).
DH_A_M = (0.0, -0.425, -0.39225, 0.0, 0.0, 0.0)
#: UR5 link offsets d_i, m.
DH_D_M = (0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823)
#: UR5 link twists alpha_i, rad.
DH_ALPHA_RAD = (pi / 2, 0.0, 0.0, pi / 2, -pi / 2, 0.0)

_HALF_PI = pi / 2.0

#: Sideways distance of the upper arm's and of the forearm's tube from their frames, m.
_SHOULDER_SIDE_M = 0.13585
_ELBOW_SIDE_M = 0.0165

_MATERIALS = {
    "ur_grey": (0.80, 0.82, 0.85, 1.0),
    "ur_blue": (0.40, 0.62, 0.82, 1.0),
    "ur_dark": (0.27, 0.30, 0.34, 1.0),
}


@dataclass(frozen=True)
class _Shape:
    """A cylinder or capsule: geometry, material, centre (m), roll-pitch-yaw (rad)."""

    kind: str
    radius_m: float
    length_m: float
    material: str
    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class _Link:
    """A link: mass (kg), centre of mass (m), its pitch (rad), inertia (ixx = iyy, izz; kg m^2)."""

    name: str
    mass_kg: float
    com_m: tuple[float, float, float]
    com_pitch_rad: float
    ixx: float
    izz: float
    shapes: tuple[_Shape, ...]


_ALONG_X = (0.0, _HALF_PI, 0.0)
_ALONG_Y = (_HALF_PI, 0.0, 0.0)

_LINKS = (
    _Link(
        "base_link", 4.0, (0.0, 0.0, 0.0), 0.0, 0.00443333, 0.0072,
        (
            _Shape("cylinder", 0.085, 0.022, "ur_dark", (0.0, 0.0, 0.011)),
            _Shape("cylinder", 0.066, 0.030, "ur_grey", (0.0, 0.0, 0.032)),
        ),
    ),
    _Link(
        "shoulder_link", 3.7, (0.0, -0.00193, -0.02561), 0.0, 0.0149723583, 0.01040625,
        (
            _Shape("cylinder", 0.060, 0.105, "ur_grey", (0.0, 0.0, 0.012)),
            _Shape("cylinder", 0.060, 0.016, "ur_blue", (0.0, 0.0, 0.070)),
            _Shape("cylinder", 0.055, 0.085, "ur_grey", (0.0, -0.040, 0.0), _ALONG_Y),
        ),
    ),
    _Link(
        "upper_arm_link", 8.393, (-0.2125, 0.0, 0.11336), _HALF_PI, 0.1338858354, 0.0151074,
        (
            _Shape("cylinder", 0.060, 0.110, "ur_grey", (0.0, 0.0, _SHOULDER_SIDE_M)),
            _Shape("cylinder", 0.060, 0.014, "ur_blue", (0.0, 0.0, _SHOULDER_SIDE_M + 0.060)),
            _Shape(
                "cylinder", 0.044, 0.350, "ur_grey",
                (DH_A_M[1] / 2, 0.0, _SHOULDER_SIDE_M), _ALONG_X,
            ),
            _Shape("cylinder", 0.054, 0.100, "ur_grey", (DH_A_M[1], 0.0, 0.130)),
            _Shape("cylinder", 0.054, 0.014, "ur_blue", (DH_A_M[1], 0.0, 0.186)),
        ),
    ),
    _Link(
        "forearm_link", 2.33, (-0.24225, 0.0, 0.0265), _HALF_PI, 0.0312168035, 0.004095,
        (
            _Shape("cylinder", 0.050, 0.100, "ur_grey", (0.0, 0.0, 0.022)),
            _Shape("cylinder", 0.050, 0.014, "ur_blue", (0.0, 0.0, -0.034)),
            _Shape(
                "cylinder", 0.037, 0.320, "ur_grey",
                (DH_A_M[2] / 2, 0.0, _ELBOW_SIDE_M), _ALONG_X,
            ),
            _Shape("cylinder", 0.041, 0.086, "ur_grey", (DH_A_M[2], 0.0, 0.018)),
            _Shape("cylinder", 0.041, 0.012, "ur_blue", (DH_A_M[2], 0.0, -0.030)),
        ),
    ),
    _Link(
        "wrist_1_link", 1.219, (0.0, -0.01634, -0.0018), 0.0, 0.0020138896, 0.0021942,
        (
            _Shape("cylinder", 0.038, 0.086, "ur_grey", (0.0, 0.0, -0.004)),
            _Shape("cylinder", 0.038, 0.012, "ur_blue", (0.0, 0.0, 0.045)),
            _Shape("cylinder", 0.037, 0.060, "ur_grey", (0.0, -0.030, 0.0), _ALONG_Y),
        ),
    ),
    _Link(
        "wrist_2_link", 1.219, (0.0, 0.01634, -0.0018), 0.0, 0.0018310396, 0.0021942,
        (
            _Shape("cylinder", 0.038, 0.086, "ur_grey", (0.0, 0.0, -0.004)),
            _Shape("cylinder", 0.038, 0.012, "ur_blue", (0.0, 0.0, 0.045)),
            _Shape("cylinder", 0.036, 0.050, "ur_grey", (0.0, 0.025, 0.0), _ALONG_Y),
        ),
    ),
    _Link(
        "wrist_3_link", 0.1879, (0.0, 0.0, -0.001159), 0.0, 8.06248e-05, 0.000132117,
        (_Shape("cylinder", 0.0375, 0.034, "ur_dark", (0.0, 0.0, -0.017)),),
    ),
)  # fmt: skip

#: Joint origins (xyz, m; rpy, rad), in the order of the links they lead to.
_ORIGINS = (
    ((0.0, 0.0, DH_D_M[0]), (0.0, 0.0, pi)),
    ((0.0, 0.0, 0.0), (_HALF_PI, 0.0, 0.0)),
    ((DH_A_M[1], 0.0, 0.0), (0.0, 0.0, 0.0)),
    ((DH_A_M[2], 0.0, DH_D_M[3]), (0.0, 0.0, 0.0)),
    ((0.0, -DH_D_M[4], 0.0), (_HALF_PI, 0.0, 0.0)),
    ((0.0, DH_D_M[5], 0.0), (-_HALF_PI, 0.0, 0.0)),
)

#: Velocity limit of every joint, rad/s.
_VELOCITY_LIMIT_RAD_S = pi
#: Effort limits, N m.
_EFFORT_LIMITS_NM = (150.0, 150.0, 150.0, 28.0, 28.0, 28.0)


def urdf_text(prefix: str = "") -> str:
    """Write the model as URDF, self-contained (no mesh files); the last link is ``tool0``.

    Parameters
    ----------
    prefix : str
        Put before each joint and link name, as a UR driver does with its ``tf_prefix``.
    """
    parts = ['<?xml version="1.0"?>', '<robot name="ur5">']
    for name, rgba in _MATERIALS.items():
        parts.append(f'<material name="{name}"><color rgba="{_numbers(rgba)}"/></material>')
    parts.extend(_link_text(link, prefix) for link in _LINKS)
    for i, name in enumerate(UR_JOINT_NAMES):
        xyz, rpy = _ORIGINS[i]
        parts.append(
            f'<joint name="{prefix}{name}" type="revolute">'
            f'<parent link="{prefix}{_LINKS[i].name}"/>'
            f'<child link="{prefix}{_LINKS[i + 1].name}"/>'
            f'<origin xyz="{_numbers(xyz)}" rpy="{_numbers(rpy)}"/><axis xyz="0 0 1"/>'
            f'<limit lower="{-UR_POSITION_LIMITS_RAD[i]!r}" upper="{UR_POSITION_LIMITS_RAD[i]!r}" '
            f'effort="{_EFFORT_LIMITS_NM[i]!r}" velocity="{_VELOCITY_LIMIT_RAD_S!r}"/>'
            '<dynamics damping="0" friction="0"/></joint>'
        )
    parts.append(
        f'<link name="{prefix}tool0"><inertial><mass value="0.01"/><origin xyz="0 0 0"/>'
        '<inertia ixx="1e-6" ixy="0" ixz="0" iyy="1e-6" iyz="0" izz="1e-6"/></inertial></link>'
        f'<joint name="{prefix}wrist_3-tool0" type="fixed"><parent link="{prefix}wrist_3_link"/>'
        f'<child link="{prefix}tool0"/><origin xyz="0 0 0" rpy="0 0 0"/></joint>'
    )
    parts.append("</robot>")
    return "\n".join(parts)


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _link_text(link: _Link, prefix: str) -> str:
    visuals = "".join(
        f'<visual><origin xyz="{_numbers(shape.xyz)}" rpy="{_numbers(shape.rpy)}"/><geometry>'
        f'<{shape.kind} radius="{shape.radius_m!r}" length="{shape.length_m!r}"/></geometry>'
        f'<material name="{shape.material}"/></visual>'
        for shape in link.shapes
    )
    return (
        f'<link name="{prefix}{link.name}"><inertial><mass value="{link.mass_kg!r}"/>'
        f'<origin xyz="{_numbers(link.com_m)}" rpy="0 {link.com_pitch_rad!r} 0"/>'
        f'<inertia ixx="{link.ixx!r}" ixy="0" ixz="0" iyy="{link.ixx!r}" iyz="0" '
        f'izz="{link.izz!r}"/></inertial>{visuals}</link>'
    )
