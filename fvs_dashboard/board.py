"""State shared by page and node: the data of the loop, and the user's actions."""

from __future__ import annotations

import queue
from collections import deque
from collections.abc import Callable, Mapping
from math import inf, isfinite, nan
from typing import Any, NamedTuple

import numpy as np

from fvs_ros import topics
from fvs_ros.rotations import nearest_rotation
from fvs_ros.status import SILENT, SILENT_S, number, vector
from fvs_ros.timeline import History

#: Length of the curves and of the ball's trail, s.
HISTORY_S, TRAIL_S = 20.0, 6.0
#: Display time of the newest value by name, s.
_SHOWN_S = {
    "ball_position": 0.5,
    "controller": SILENT_S,
    "detector": 2.0,
    "answer": 12.0,
}
#: Largest age of the ball position for the curve of the prediction error, s.
_JUDGED_S = 1.0
#: Least values on the logarithmic scales: error, mm, and ratio.
_SMALLEST_MM, _SMALLEST_RATIO = 1e-3, 1e-4


# --- what a person wants ---


class Action(NamedTuple):
    """One user action with its value: a target, on or off, or a setting.

    A target is x, y, z, camera frame, m, and its quaternion, w first, where it was turned by hand.

    The name is a service of the controller, ``target``, ``tour``, ``reset`` or ``bump``, or
    ``node/parameter`` to set a parameter.
    """

    name: str
    value: Any = None


START, STOP, SET_CURRENT = Action("start"), Action("stop"), Action("set_current_as_target")
RESET, BUMP = Action("reset"), Action("bump")


class Actions:
    """The queue between the page's threads and the node's; ``wake`` is called at each action."""

    def __init__(self, wake: Callable[[], None]) -> None:
        self._queue: queue.SimpleQueue[Action] = queue.SimpleQueue()
        self._wake = wake

    def put(self, action: Action) -> None:
        """Add an action, from any thread."""
        self._queue.put(action)
        self._wake()

    def drain(self) -> list[Action]:
        """All actions since the last call, in order; only the last one of each name.

        A stop comes first and discards earlier motions. A reset is a stop, too.
        """
        wanted: dict[str, Action] = {}
        while not self._queue.empty():  # this is its only reader
            action = self._queue.get_nowait()
            if action in (STOP, RESET):
                settings = {name: one for name, one in wanted.items() if "/" in name}
                wanted = {action.name: action, **settings}
            else:
                wanted.pop(action.name, None)
                wanted[action.name] = action
        return list(wanted.values())


# --- what is known ---


class Controller:
    """The controller's last status: key numbers and reason in words, or its silence."""

    def __init__(self, values: Mapping[str, str], sentence: str) -> None:
        self.values, self.sentence = values, sentence
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


class Trace:
    """The last seconds of some numbers, ``columns`` at a time."""

    def __init__(self, length_s: float, columns: int) -> None:
        self._length_s, self._columns = length_s, columns
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
    """The data of a loop with ``n_joints`` joints; times are on the steady clock, s."""

    def __init__(self, n_joints: int) -> None:
        self._newest: dict[str, tuple[float, Any]] = {}
        self._joints = History()
        self._unlearned: tuple[float, np.ndarray] | None = None  # ball: stamp and position
        #: Curves: distance to the target and its parts x, y, z, mm; joint speeds, rad/s; one-step
        #: prediction error over that of predicting rest.
        self.error_mm = Trace(HISTORY_S, 4)
        self.speed_rad_s = Trace(HISTORY_S, n_joints)
        self.ratio = Trace(HISTORY_S, 1)
        #: Where the ball was, camera frame, m.
        self.trail_m = Trace(TRAIL_S, 3)
        self.placement = CameraPlacement()
        #: Parameters of the other nodes, by node; empty for one that does not run.
        self.parameters: dict[str, Mapping[str, Any]] = {}
        self.tour = False

    def note(self, name: str, now_s: float, value: Any) -> None:
        """Store the newest value of a name."""
        self._newest[name] = now_s, value

    def add_joints(
        self, now_s: float, stamp_s: float, joints_rad: np.ndarray, velocity_rad_s: np.ndarray
    ) -> None:
        """Add joint positions and velocities, kinematic order, shape (n,)."""
        self.note("joint_states", now_s, joints_rad)
        self._joints.add(stamp_s, joints_rad)
        self.speed_rad_s.add(now_s, np.abs(velocity_rad_s))

    def add_ball(self, now_s: float, stamp_s: float, feature_m: np.ndarray) -> None:
        """Add a ball's position or a tag's pose, camera frame, m, (m,), and its stamp."""
        self.note("ball_position", now_s, feature_m)
        self._unlearned = stamp_s, feature_m[:3]
        self.trail_m.add(now_s, feature_m[:3])

    def add_status(self, now_s: float, controller: Controller) -> None:
        """Add the controller's status."""
        self.note("controller", now_s, controller)
        if controller.target_m is not None and controller.position_m is not None:
            parts_m = [controller.error_m, *(controller.target_m - controller.position_m)]
            self.error_mm.add(now_s, np.maximum(1e3 * np.abs(parts_m), _SMALLEST_MM))
        if self.age_s("ball_position", now_s) < _JUDGED_S:
            ratio = controller.number("prediction_error_ratio")
            self.ratio.add(now_s, np.maximum([ratio], _SMALLEST_RATIO))

    def place_camera(self, pose: np.ndarray) -> None:
        """Take the camera's true pose, (4, 4), m; clears the trail, which would jump."""
        self.placement.place(pose)
        self.trail_m.clear()

    def learn_camera(self, flange_at: Callable[[np.ndarray], np.ndarray]) -> None:
        """Learn the camera's place from the newest ball, unless it is known.

        ``flange_at`` gives the flange's pose, shape (4, 4), at joints, rad, shape (n,).
        """
        if self.placement.true or self._unlearned is None:
            return
        stamp_s, position_m = self._unlearned
        joints = self._joints.at(stamp_s)
        if joints is not None:
            self._unlearned = None
            self.placement.add(flange_at(joints), position_m)

    def newest(self, name: str, now_s: float) -> Any:
        """The newest value of a name; None if there is none or it is too old."""
        since_s, value = self._newest.get(name, (-inf, None))
        return value if now_s - since_s <= _SHOWN_S.get(name, inf) else None

    def age_s(self, name: str, now_s: float) -> float:
        """Age of the newest of a name, s; infinite if there is none."""
        return now_s - self._newest.get(name, (-inf, None))[0]

    def parameter(self, node: str, name: str) -> Any:
        """A node's parameter; None while it is not known."""
        return self.parameters.get(node, {}).get(name)

    def limit(self, name: str) -> float:
        """A limit of the controller; NaN while it is not known."""
        value = self.parameter(topics.CONTROLLER, name)
        return value if isinstance(value, float) else nan

    def controller(self, now_s: float) -> Controller:
        """The controller's last status, unless it is old."""
        known = self.newest("controller", now_s)
        if known is not None:
            return known
        age_s = self.age_s("controller", now_s)
        since = f" for {age_s:.0f} s" if isfinite(age_s) else "; is fvs_controller_node running?"
        return Controller({}, f"no word from the controller{since}")


# --- where the camera stands: to draw by, never to control by ---

#: Positions of the ball that are remembered, and the fewest that are enough.
_MEMORY, _FEWEST = 300, 12
#: Least change of the flange's pose, in any entry, for a new pair; m, or 1 in the rotation matrix.
_STEP = 0.02
#: Least second extent (rms) of the ball's path that determines the camera's rotation, m.
_LEAST_EXTENT_M = 0.03
#: A pose with a larger median error is discarded, m: the camera was moved.
_LARGEST_ERROR_M = 0.05
#: Error above which a position is weighted down, m, and number of passes.
_OUTLIER_M, _PASSES = 0.01, 3

UNKNOWN = "the camera's place is not known yet: it is learned while the arm moves"


class CameraPlacement:
    """The camera's pose in the robot's base frame: a simulator's, or learned from the motion.

    With the flange's rotation T and place f, a ball that is seen at x and carried at b is at
    ``R x + t = f + T b``: linear in R, t and b. The nearest rotation of R then fixes the others.
    """

    def __init__(self) -> None:
        #: Whether the pose is the true one, not learned.
        self.true = False
        #: Shape (4, 4), m, or None.
        self.pose: np.ndarray | None = None
        #: A sentence about the pose for the user, or empty.
        self.note = UNKNOWN
        self._pairs: deque[tuple[np.ndarray, np.ndarray]] = deque(maxlen=_MEMORY)

    def place(self, pose: np.ndarray) -> None:
        """Take the true pose."""
        self.true, self.pose, self.note = True, pose, ""

    def add(self, flange: np.ndarray, ball_m: np.ndarray) -> None:
        """Learn from the flange's pose, (4, 4), and the ball, camera frame, at the same time."""
        if self._pairs and np.abs(flange - self._pairs[-1][0]).max() < _STEP:
            return
        self._pairs.append((flange, ball_m))
        self.pose, self.note = None, UNKNOWN
        if len(self._pairs) < _FEWEST:
            return
        flanges, seen_m = (np.array(part) for part in zip(*self._pairs, strict=True))
        turns, origins_m = flanges[:, :3, :3], flanges[:, :3, 3]
        unit = np.broadcast_to(np.eye(3), turns.shape)
        by_rotation = np.einsum("ij,kl->kijl", np.eye(3), seen_m).reshape(-1, 3, 9)
        rows = np.concatenate([by_rotation, unit, -turns], axis=2)
        weights = np.ones(len(seen_m))
        for _ in range(_PASSES):
            whole = (weights[:, None, None] * rows).reshape(-1, 15)
            wanted = (weights[:, None] * origins_m).ravel()
            rotation = nearest_rotation(np.linalg.lstsq(whole, wanted)[0][:9].reshape(3, 3))
            wanted = wanted - whole[:, :9] @ rotation.ravel()
            place_m, ball_m = np.split(np.linalg.lstsq(whole[:, 9:], wanted)[0], 2)
            off_m = seen_m @ rotation.T + place_m - origins_m - turns @ ball_m
            errors_m = np.linalg.norm(off_m, axis=1)
            weights = 1.0 / np.hypot(_OUTLIER_M, errors_m)
        extent_m = np.linalg.svd(seen_m - seen_m.mean(axis=0), compute_uv=False)[1]
        error_m = np.median(errors_m)
        if extent_m > _LEAST_EXTENT_M * len(seen_m) ** 0.5 and error_m < _LARGEST_ERROR_M:
            self.pose = np.eye(4)
            self.pose[:3, :3], self.pose[:3, 3] = rotation, place_m
            self.note = (
                f"the camera's place is learned: ball and arm agree to {1e3 * error_m:.0f} mm"
            )
