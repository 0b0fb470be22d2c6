"""What is known of the loop: the newest of everything, and the last seconds of some numbers."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from math import inf, isfinite, nan
from typing import Any

import numpy as np

from fvs_dashboard.actions import CONTROLLER
from fvs_dashboard.placement import CameraPlacement
from fvs_ros.status import SILENT, SILENT_S, number, vector
from fvs_ros.timeline import History

#: Length of the curves and of the ball's trail, s.
HISTORY_S, TRAIL_S = 20.0, 6.0
#: How long the newest of a name is shown, s.
_SHOWN_S = {
    "ball_position": 0.5,
    "controller": SILENT_S,
    "detector": 2.0,
    "answer": 12.0,
    "behind": 5.0,
}
#: The prediction error counts only while the ball was seen within this, s.
_JUDGED_S = 1.0
#: A logarithmic scale has no zero, mm.
_SMALLEST_MM, _SMALLEST_RATIO = 1e-3, 1e-4


class Controller:
    """The controller's last status, or its silence.

    Parameters
    ----------
    values : mapping of str to str
        The key numbers of the status.
    sentence : str
        The reason in words.
    """

    def __init__(self, values: Mapping[str, str], sentence: str) -> None:
        self.values = values
        self.sentence = sentence
        self.state = values.get("state", SILENT)
        self.reason = values.get("reason", "")
        self.silent = self.state == SILENT
        self.error_m = self.number("error_m")
        #: Camera frame, m, shape (3,), or None.
        self.target_m = vector(values, "target_{}_m")
        self.position_m = vector(values, "position_{}_m")

    def number(self, key: str) -> float:
        """A key number; NaN while unknown."""
        return number(self.values, key)

    @property
    def goes_to_targets(self) -> bool:
        """Whether a target sent now would be gone to."""
        return self.state == "SERVOING" or self.reason == "NO_TARGET"


class Trace:
    """The last seconds of some numbers.

    Parameters
    ----------
    length_s : float
        How far it reaches back, s.
    columns : int
        How many numbers at a time.
    """

    def __init__(self, length_s: float, columns: int) -> None:
        self._length_s = length_s
        self._columns = columns
        self._rows: deque[np.ndarray] = deque()

    def add(self, now_s: float, values: np.ndarray) -> None:
        """Append finite numbers, shape (columns,); others are left out."""
        if np.isfinite(values).all():
            self._rows.append(np.array([now_s, *values]))

    def window(self, now_s: float) -> np.ndarray:
        """Time before now (s, negative) and numbers, shape (n, 1 + columns), oldest first."""
        while self._rows and self._rows[0][0] < now_s - self._length_s:
            self._rows.popleft()
        rows = np.array(self._rows).reshape(-1, 1 + self._columns)
        rows[:, 0] -= now_s
        return rows

    def clear(self) -> None:
        """Forget everything."""
        self._rows.clear()


class Board:
    """All that is known.

    Parameters
    ----------
    n_joints : int
        Number of joints, n.

    Attributes
    ----------
    error_mm, speed_rad_s, ratio : Trace
        Curves: distance to the target and its parts x, y, z, mm; n joint speeds, rad/s; one-step
        prediction error over that of predicting rest.
    trail_m : Trace
        Where the ball was, camera frame, m.
    placement : CameraPlacement
        Where the camera stands.
    parameters : dict
        Parameters of the other nodes, by node; empty for one that does not run.
    tour : bool
        Whether the tour goes on.
    """

    def __init__(self, n_joints: int) -> None:
        self._newest: dict[str, tuple[float, Any]] = {}
        self._joints = History()
        self._unlearned: tuple[float, np.ndarray] | None = None  # ball: stamp and position
        self.error_mm = Trace(HISTORY_S, 4)
        self.speed_rad_s = Trace(HISTORY_S, n_joints)
        self.ratio = Trace(HISTORY_S, 1)
        self.trail_m = Trace(TRAIL_S, 3)
        self.placement = CameraPlacement()
        self.parameters: dict[str, Mapping[str, Any]] = {}
        self.tour = False

    # --- what comes in ---

    def tell(self, name: str, now_s: float, value: Any) -> None:
        """Note the newest of a name, steady clock, s."""
        self._newest[name] = now_s, value

    def add_joints(
        self, now_s: float, stamp_s: float, joints_rad: np.ndarray, velocity_rad_s: np.ndarray
    ) -> None:
        """Tell joint positions and velocities, kinematic order, shape (n,)."""
        self.tell("joint_states", now_s, joints_rad)
        self._joints.add(stamp_s, joints_rad)
        self.speed_rad_s.add(now_s, np.abs(velocity_rad_s))

    def add_ball(self, now_s: float, stamp_s: float, position_m: np.ndarray) -> None:
        """Tell a ball position, camera frame, m, shape (3,), and its exposure's stamp."""
        self.tell("ball_position", now_s, position_m)
        self._unlearned = stamp_s, position_m
        self.trail_m.add(now_s, position_m)

    def add_status(self, now_s: float, controller: Controller) -> None:
        """Tell the controller's status."""
        self.tell("controller", now_s, controller)
        if controller.target_m is not None and controller.position_m is not None:
            parts_m = [controller.error_m, *(controller.target_m - controller.position_m)]
            self.error_mm.add(now_s, np.maximum(1e3 * np.abs(parts_m), _SMALLEST_MM))
        if self.age_s("ball_position", now_s) < _JUDGED_S:
            ratio = controller.number("prediction_error_ratio")
            self.ratio.add(now_s, np.maximum([ratio], _SMALLEST_RATIO))

    def tell_camera(self, pose: np.ndarray) -> None:
        """Tell the camera's true pose, shape (4, 4), m; the trail is forgotten: it would jump."""
        self.placement.tell(pose)
        self.trail_m.clear()

    def learn_camera(self, flange_at: Callable[[np.ndarray], np.ndarray]) -> None:
        """Learn the camera's place from the newest ball, unless it is told.

        ``flange_at`` gives the flange's pose, shape (4, 4), at joints, rad, shape (n,).
        """
        if self.placement.told or self._unlearned is None:
            return
        stamp_s, position_m = self._unlearned
        joints = self._joints.at(stamp_s)
        if joints is not None:
            self._unlearned = None
            self.placement.add(flange_at(joints), position_m)

    # --- what is known ---

    def newest(self, name: str, now_s: float) -> Any:
        """The newest of a name; None if there is none, or it is too old to be shown."""
        told_s, value = self._newest.get(name, (-inf, None))
        return value if now_s - told_s <= _SHOWN_S.get(name, inf) else None

    def age_s(self, name: str, now_s: float) -> float:
        """Age of the newest of a name, s; infinite if there is none."""
        return now_s - self._newest.get(name, (-inf, None))[0]

    def parameter(self, node: str, name: str) -> Any:
        """A node's parameter; None while it is not known."""
        return self.parameters.get(node, {}).get(name)

    def limit(self, name: str) -> float:
        """A limit of the controller; NaN while it is not known."""
        value = self.parameter(CONTROLLER, name)
        return value if isinstance(value, float) else nan

    def controller(self, now_s: float) -> Controller:
        """The controller's last word, unless it is old."""
        known = self.newest("controller", now_s)
        if known is not None:
            return known
        age_s = self.age_s("controller", now_s)
        since = f" for {age_s:.0f} s" if isfinite(age_s) else "; is fvs_controller_node running?"
        return Controller({}, f"no word from the controller{since}")
