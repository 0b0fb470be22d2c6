"""State shared by page and node: the data of the loop, and the user's actions."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from math import degrees, inf, isfinite, nan
from typing import Any, NamedTuple

import numpy as np

from fvs_controller_node.references import Reference
from fvs_ros import topics
from fvs_ros.kinds import Kind
from fvs_ros.kinds.ball import Ball
from fvs_ros.status import SILENT, SILENT_S, number, vector

#: Length of the curves, s.
HISTORY_S = 20.0
#: The controller's parameter with the name of the reference.
REFERENCE = f"{topics.CONTROLLER}/reference"
#: The simulator's parameters of where the object is, in the robot's root link.
OBJECT_PLACE = "object_position_m", "object_rotation_deg"
#: Display time of the newest value by name, s.
_SHOWN_S = {"controller": SILENT_S, "detector": 2.0, "answer": 12.0}
_SHOWN_S |= dict.fromkeys(("feature", "truth", "true_errors", "object"), 0.5)


class Action(NamedTuple):
    """One user action with its value: a target, on or off, or a setting.

    A target is x, y, z, camera frame, m, and, of what turns, its quaternion, w first; or u and v,
    px, of the first point in each camera's picture.

    The name is a service of the controller, ``target``, ``tour``, ``reset`` or ``bump``, ``teach``
    or ``go`` with the name of a reference, or ``node/parameter`` to set a parameter.
    """

    name: str
    value: Any = None


class Controller:
    """The controller's last status: key numbers and reason in words, or its silence."""

    def __init__(self, values: Mapping[str, str], sentence: str) -> None:
        self.values, self.sentence = values, sentence
        self.state = values.get("state", SILENT)
        self.reason = values.get("reason", "")
        self.silent = self.state == SILENT
        #: Camera frame, m, shape (3,), or None.
        self.position_m = vector(values, "position_{}_m")

    def number(self, key: str) -> float:
        """A key number; NaN while unknown."""
        return number(self.values, key)

    def target(self, kind: Kind) -> np.ndarray | None:
        """The target, (m,); None while a part of it is unknown."""
        ends = [f"{name}_m" if i < kind.box_size else name for i, name in enumerate(kind.columns)]
        numbers = np.array([self.number(f"target_{end}") for end in ends])
        return kind.of_columns(numbers) if np.isfinite(numbers).all() else None

    def target_px(self, kind: Kind) -> np.ndarray:
        """The target's image points, px, by camera, (C, K, 2); NaN while unknown."""
        numbers = [self.number(f"target_{column}") for column in kind.columns]
        return np.reshape(numbers, (len(kind.cameras), -1, 2))

    def errors(self, kind: Kind) -> dict[str, float]:
        """Lengths of the estimated error, m and rad, by name; NaN while unknown."""
        return {key: self.number(key) for key in kind.status_values(None)}


def way_m(errors: Mapping[str, float]) -> float:
    """The distance among the lengths of an error: of what turns too, not its angle."""
    return errors.get("way_m", errors["error_m"])


class Trace:
    """The last seconds of some numbers, ``columns`` at a time."""

    def __init__(self, columns: int) -> None:
        self._columns = columns
        self._rows: deque[np.ndarray] = deque()

    def add(self, now_s: float, values: np.ndarray) -> None:
        """Append numbers, shape (columns,), if one of them is finite; NaN leaves a gap."""
        if np.isfinite(values).any():
            self._rows.append(np.array([now_s, *values]))

    def window(self, now_s: float) -> np.ndarray:
        """Time before now (s, negative) and numbers, shape (n, 1 + columns), oldest first."""
        while self._rows and self._rows[0][0] < now_s - HISTORY_S:
            self._rows.popleft()
        rows = np.array(self._rows).reshape(-1, 1 + self._columns)
        rows[:, 0] -= now_s
        return rows


class Board:
    """The data of a loop; times are on the steady clock, s."""

    def __init__(self, joint_names: Sequence[str], kind: Kind | None = None) -> None:
        self._kind = kind or Ball()
        self._newest: dict[tuple[str, int], tuple[float, Any]] = {}
        #: Curves: estimated and true distance to the target, mm or px, and angle, degrees; joint
        #: speeds, rad/s; one-step prediction error over that of predicting rest.
        self.error = Trace(3)
        self.name_joints(joint_names)
        self.ratio = Trace(1)
        #: Frame and pose in it, (4, 4), m, of the camera; None while not known.
        self.camera: tuple[str, np.ndarray] | None = None
        #: Parameters of the other nodes, by node; empty for one that does not run.
        self.parameters: dict[str, Mapping[str, Any]] = {}
        self.tour = False
        #: Taught references by name, or what is wrong with one; and with the file, in words.
        self.references: Mapping[str, Reference | str] = {}
        self.references_problem = ""

    def name_joints(self, names: Sequence[str]) -> None:
        """Begin with these joints, kinematic order."""
        self.joint_names, self.speed_rad_s = names, Trace(len(names))

    def note(self, name: str, now_s: float, value: Any, camera: int = 0) -> None:
        """Store the newest value of a name, of one of the cameras."""
        self._newest[name, camera] = now_s, value

    def add_joints(self, now_s: float, joints_rad: np.ndarray, velocity_rad_s: np.ndarray) -> None:
        """Add joint positions and velocities, kinematic order, shape (n,)."""
        self.note("joint_states", now_s, joints_rad)
        self.speed_rad_s.add(now_s, np.abs(velocity_rad_s))

    def add_status(self, now_s: float, controller: Controller) -> None:
        """Add the controller's status."""
        self.note("controller", now_s, controller)
        truth, target = self.feature(now_s, "truth"), controller.target(self._kind)
        if truth is not None and target is not None:
            error_m = self._kind.error(truth, target)
            self.note("true_errors", now_s, self._kind.status_values(error_m))
        estimated = controller.errors(self._kind)
        unit_m = 1e-3 if self._kind.rigid else self._kind.unit[0]
        ways_m = np.array([way_m(estimated), way_m(self.true_errors(now_s))])
        angle_deg = degrees(estimated.get("angle_rad", nan))
        self.error.add(now_s, np.append(ways_m / unit_m, angle_deg))
        if self.feature(now_s) is not None:
            self.ratio.add(now_s, np.array([controller.number("prediction_error_ratio")]))

    def newest(self, name: str, now_s: float, camera: int = 0) -> Any:
        """The newest value of a name; None if there is none or it is too old."""
        since_s, value = self._newest.get((name, camera), (-inf, None))
        return value if now_s - since_s <= _SHOWN_S.get(name, inf) else None

    def feature(self, now_s: float, name: str = "feature") -> np.ndarray | None:
        """What is servoed, (m,), if all cameras see it; or a simulator's ``truth`` of it."""
        cameras = range(len(self._kind.cameras))
        parts = [self.newest(name, now_s, camera) for camera in cameras]
        return None if any(part is None for part in parts) else np.concatenate(parts)

    def true_errors(self, now_s: float) -> dict[str, float]:
        """Lengths of the true error at the last status, by name; NaN without a simulator."""
        return self.newest("true_errors", now_s) or self._kind.status_values(None)

    def parameter(self, node: str, name: str) -> Any:
        """A node's parameter; None while it is not known."""
        return self.parameters.get(node, {}).get(name)

    def controller(self, now_s: float) -> Controller:
        """The controller's last status, unless it is old."""
        known = self.newest("controller", now_s)
        if known is not None:
            return known
        age_s = now_s - self._newest.get(("controller", 0), (-inf, None))[0]
        since = f" for {age_s:.0f} s" if isfinite(age_s) else "; is fvs_controller_node running?"
        return Controller({}, f"no word from the controller{since}")
