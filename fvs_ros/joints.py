"""Joint names, their kinematic order, and the map from any ``JointState`` into it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np

from fvs_ros.params import Parameters, parameter
from fvs_ros.vectors import largest, plausible

#: The UR joints in kinematic order, base to flange: the order of every vector in this project.
UR_JOINT_NAMES = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)

#: A UR turns each joint by so much to either side, rad, the elbow less; kinematic order.
UR_POSITION_LIMITS_RAD = (2 * pi, 2 * pi, pi, 2 * pi, 2 * pi, 2 * pi)

#: After a gap in the joint states, a joint within this distance, rad, of its last position but for
#: full turns was wrapped by the driver: the arm was held, and would otherwise go back by a turn.
_HELD_RAD = 0.25
#: After a longer gap somebody may have turned it, s.
_SILENCE_S = 20.0

#: Fastest joint, rad/s.
_FASTEST_RAD_S = 1.5 * pi
#: Slack of a step between two joint states, rad: more is a jump.
_JUMP_RAD = 0.1


@dataclass(frozen=True)
class ArmJoints(Parameters):
    """How a node knows the arm's joints."""

    joint_names: tuple[str, ...] = parameter(
        UR_JOINT_NAMES, "The joints in kinematic order, base to flange, without tf_prefix."
    )
    tf_prefix: str = parameter("", "Prefix of the joint names: that of the robot's driver.")


JOINT_PARAMETERS = ArmJoints.declared()


class JointStateError(ValueError):
    """A joint state that cannot be used; the text says what was wrong and what was expected."""


class ForeignJointsError(JointStateError):
    """A joint state that holds none of the wanted joints: another device's, to be passed over."""


class JointMap:
    """Picks the wanted joints, by name, out of messages in any order and with extra joints.

    Where a driver wraps a joint, at pi or elsewhere, its positions go on; a step that no joint can
    make is refused. The robot's driver puts ``tf_prefix`` before each name. The first positions are
    within half a turn of ``middle_rad``, rad, (n,), if that is set. Names that are not different
    raise a ``ValueError``.
    """

    def __init__(self, names: Sequence[str] = UR_JOINT_NAMES, tf_prefix: str = "") -> None:
        self.names = tuple(tf_prefix + name for name in names)
        if not self.names or len(set(self.names)) != len(self.names):
            raise ValueError(
                f"joint_names must be different names in kinematic order, got {list(self.names)}"
            )
        self.middle_rad: np.ndarray | None = None
        self._cached_for: tuple[str, ...] | None = None
        self._indices: list[int] = []
        self._wrapped: np.ndarray | None = None  # the last positions, as they came
        self._turns_rad: np.ndarray | float = 0.0  # full turns that the driver left out
        self._stamp_s = 0.0

    def positions(
        self, names: Sequence[str], values: Sequence[float], stamp_s: float | None = None
    ) -> np.ndarray:
        """Angles, rad, (n,), in kinematic order, of a message with these names and values.

        They are finite and plausible. Without a stamp, s, they are as they come, with any step. A
        ``JointStateError`` says that some joints are missing, sizes differ, an angle is not finite
        or implausible, there is no stamp, or a joint jumped; a ``ForeignJointsError``, that the
        message holds none of the wanted joints.
        """
        key = tuple(names)
        if key != self._cached_for:
            missing = [name for name in self.names if name not in key]
            if len(missing) == len(self.names):
                raise ForeignJointsError(
                    f"joint_states names {list(key)}, none of the wanted {list(self.names)}"
                )
            if missing:
                raise JointStateError(f"joint_states lacks {missing}; it names {list(key)}")
            twice = [name for name in self.names if key.count(name) > 1]
            if twice:
                raise JointStateError(f"joint_states names {twice} more than once")
            self._indices = [key.index(name) for name in self.names]
            self._cached_for = key
        if len(values) != len(key):
            raise JointStateError(f"joint_states has {len(values)} positions for {len(key)} names")
        positions = np.array([values[i] for i in self._indices], dtype=float)
        if not plausible(positions):
            bad = [n for n, p in zip(self.names, positions, strict=True) if not plausible(p)]
            raise JointStateError(
                f"joint_states has a position too large or not finite for {bad}: "
                "expected rad or m, no degrees"
            )
        if stamp_s == 0.0:
            raise JointStateError("joint_states has no stamp (0): its publisher has to set it")
        return positions if stamp_s is None else self._continued(positions, stamp_s)

    def _continued(self, wrapped: np.ndarray, stamp_s: float) -> np.ndarray:
        """Less full turns, where a step is possible only without them."""
        last, passed_s = self._wrapped, stamp_s - self._stamp_s
        self._wrapped, self._stamp_s = wrapped, stamp_s
        if last is None:
            if self.middle_rad is not None:
                self._turns_rad = _full_turns(self.middle_rad - wrapped)
            return wrapped + self._turns_rad
        step, possible_rad = wrapped - last, _JUMP_RAD + _FASTEST_RAD_S * abs(passed_s)
        if largest(step) > pi:
            turns_rad = _full_turns(step)
            held_rad = _HELD_RAD if abs(passed_s) < _SILENCE_S else 0.0
            most_rad = possible_rad if possible_rad < pi else held_rad
            turns_rad[np.abs(step - turns_rad) > most_rad] = 0.0
            step, self._turns_rad = step - turns_rad, self._turns_rad - turns_rad
        if passed_s > 0.0 and largest(step) > possible_rad:
            joint = int(np.abs(step).argmax())
            doubt = "do two nodes publish joint states?"
            if largest(wrapped) > 4.0 * pi:
                doubt = f"are they in degrees, expected rad, or {doubt}"
            jumped = f"{self.names[joint]} jumped by {abs(step[joint]):.2f} rad (m)"
            raise JointStateError(f"{jumped} in {passed_s:.3f} s; {doubt}")
        return wrapped + self._turns_rad


def _full_turns(angles_rad: np.ndarray) -> np.ndarray:
    """The multiples of a full turn that are nearest to angles, rad."""
    return 2.0 * pi * np.round(angles_rad / (2.0 * pi))
