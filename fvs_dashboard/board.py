"""What is known of the loop: the newest messages as plain values, and the last seconds of some."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from math import inf, isfinite, nan
from typing import Any

import numpy as np

from fvs_dashboard import picture
from fvs_dashboard.actions import CONTROLLER
from fvs_dashboard.placement import CameraPlacement, Pose
from fvs_ros.camera import Intrinsics
from fvs_ros.history import JointHistory
from fvs_ros.joints import N_JOINTS
from fvs_ros.status import SILENT, SILENT_S, number, vector

#: Length of the curves and of the ball's trail, s.
HISTORY_S, TRAIL_S = 20.0, 6.0
#: A ball seen longer ago is not drawn, an answer said longer ago not shown, s.
_BALL_S, _ANSWER_S = 0.5, 12.0
#: Images come later than what was found in them, up to so much, s; a position this near to an
#: image's stamp was found in it, s.
_LATEST_IMAGE_S, _SAME_IMAGE_S = 10.0, 0.02
#: The prediction error is of a ball that was seen within this, s.
_JUDGED_S = 1.0
#: A picture that was exposed longer ago is not taken for one of now, s.
_OLD_PICTURE_S = 2.0
#: Times that go back by more than this are of a clock that was set, s.
_BACKSTEP_S = 1.0
#: A detector's word that is older than this is none, s.
_DETECTOR_S = 2.0
#: On a logarithmic scale nothing is zero, mm.
_SMALLEST_MM, _SMALLEST_RATIO = 1e-3, 1e-4
_FIELD_OF_VIEW = (0.743, 4.0 / 3.0)  # a RealSense's, until the camera tells its own


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
        """Append numbers, shape (columns,); what is not finite is left out."""
        values = np.asarray(values, dtype=float)
        if self._rows and now_s < self._rows[-1][0] - _BACKSTEP_S:
            self.clear()
        if np.isfinite(values).all():
            self._rows.append(np.concatenate([[now_s], values]))
        self._trim(now_s)

    def window(self, now_s: float) -> np.ndarray:
        """Time before now (s, negative) and numbers, shape (n, 1 + columns), oldest first."""
        self._trim(now_s)
        rows = self.rows
        rows[:, 0] -= now_s
        return rows

    @property
    def rows(self) -> np.ndarray:
        """Time and numbers as they were added, shape (n, 1 + columns), oldest first."""
        return np.array(self._rows).reshape(-1, 1 + self._columns)

    def clear(self) -> None:
        """Forget everything."""
        self._rows.clear()

    def _trim(self, now_s: float) -> None:
        while self._rows and self._rows[0][0] < now_s - self._length_s:
            self._rows.popleft()


class Board:
    """All that is known.

    Parameters
    ----------
    ball_radius_m : float
        Radius of the ball, m.

    Attributes
    ----------
    error_mm, speed_rad_s, ratio : Trace
        What is drawn over time: distance to the target and its parts x, y, z, mm; six joint speeds,
        rad/s; one-step prediction error over that of predicting rest.
    trail_m : Trace
        Where the ball was, camera frame, m.
    placement : CameraPlacement
        Where the camera stands.
    parameters : dict
        Parameters that the page asks for, by node; empty of a node that does not run.
    waits_for : str
        What the camera's picture waits for, in words.
    tour : bool
        Whether the tour goes on.
    """

    def __init__(self, ball_radius_m: float) -> None:
        self._ball_radius_m = ball_radius_m
        self._controller = Controller({}, "")
        self._heard_s: dict[str, float] = {}
        self._history = JointHistory()
        self._velocity = np.full(N_JOINTS, nan)
        self._ball: tuple[float, np.ndarray] | None = None  # exposure's stamp and position
        self._learned_from = -inf
        self._seen = Trace(_LATEST_IMAGE_S, 3)  # the ball, by the exposures' stamps
        self._image: tuple[float, float, np.ndarray] | None = None
        self._drawn: tuple[float, np.ndarray] | None = None  # the last image, and its exposure
        self._words: str | None = None  # that stand in the picture
        self._intrinsics: Intrinsics | None = None
        self._answer, self._answer_s = "", -inf
        self._notes: dict[str, tuple[str, float]] = {}  # text, and until when
        self._detector = ""
        self.error_mm = Trace(HISTORY_S, 4)
        self.speed_rad_s = Trace(HISTORY_S, N_JOINTS)
        self.ratio = Trace(HISTORY_S, 1)
        self.trail_m = Trace(TRAIL_S, 3)
        self.placement = CameraPlacement()
        self.parameters: dict[str, Mapping[str, Any]] = {}
        self.waits_for = ""
        self.tour = False

    # --- what comes in ---

    def add_joints(
        self, now_s: float, stamp_s: float, joints_rad: np.ndarray, velocity_rad_s: np.ndarray
    ) -> None:
        """Tell joint positions and velocities, kinematic order, shape (6,)."""
        self._heard_s["joint_states"] = now_s
        self._history.add(stamp_s, joints_rad)
        self._velocity = velocity_rad_s

    def add_ball(self, now_s: float, stamp_s: float, position_m: np.ndarray) -> None:
        """Tell a ball position, camera frame, m, shape (3,), and its exposure's stamp."""
        self._heard_s["ball_position"] = now_s
        self._ball = stamp_s, position_m
        self._seen.add(stamp_s, position_m)
        self.trail_m.add(now_s, position_m)

    def add_status(self, now_s: float, values: Mapping[str, str], sentence: str) -> None:
        """Tell the controller's status."""
        self._heard_s["status"] = now_s
        self._controller = controller = Controller(values, sentence)
        if controller.target_m is not None and controller.position_m is not None:
            error_m = controller.target_m - controller.position_m
            parts = 1e3 * np.abs(np.concatenate([[controller.error_m], error_m]))
            self.error_mm.add(now_s, np.maximum(parts, _SMALLEST_MM))
        # Without a ball nothing is judged: what the estimator goes on saying is of before.
        if self.age_s("ball_position", now_s) < _JUDGED_S:
            ratio = controller.number("prediction_error_ratio")
            self.ratio.add(now_s, np.maximum([ratio], _SMALLEST_RATIO))

    def add_detector(self, now_s: float, sentence: str) -> None:
        """Tell the detector's sentence."""
        self._heard_s["detector"] = now_s
        self._detector = sentence

    def add_image(self, exposed_s: float, stamp_s: float, image_rgb: np.ndarray) -> None:
        """Tell a camera image, uint8, shape (height, width, 3).

        It was exposed at ``exposed_s`` of the steady clock, and is stamped with ``stamp_s``.
        """
        self._image = exposed_s, stamp_s, image_rgb

    def set_intrinsics(self, intrinsics: Intrinsics) -> None:
        """Tell the camera's intrinsics."""
        self._intrinsics = intrinsics

    def tell_camera(self, pose: Pose) -> None:
        """Tell where the camera really is; what was seen from elsewhere is forgotten."""
        self.placement.tell(pose)
        self.trail_m.clear()

    def note(self, name: str, text: str, until_s: float = inf) -> None:
        """Tell how the page itself is, until a time or until told otherwise; empty if well."""
        self._notes[name] = text, until_s

    def answer(self, now_s: float, text: str) -> None:
        """Tell what was answered to a person's wish."""
        self._answer, self._answer_s = text, now_s

    def learn_camera(self, flange_at: Callable[[np.ndarray], np.ndarray]) -> None:
        """Learn the camera's place from the newest ball, unless it is told.

        ``flange_at`` gives the flange's pose, shape (4, 4), at joints, rad, shape (6,).
        """
        if self.placement.told or self._ball is None or self._ball[0] == self._learned_from:
            return
        stamp_s, position_m = self._ball
        joints = self._history.at(stamp_s)
        if joints is not None:
            self._learned_from = stamp_s
            self.placement.add(flange_at(joints), position_m)

    def sample(self, now_s: float) -> None:
        """Note what is drawn over time and does not come with the status."""
        if self.age_s("joint_states", now_s) < SILENT_S:
            self.speed_rad_s.add(now_s, np.abs(self._velocity))

    # --- what is known ---

    def age_s(self, name: str, now_s: float) -> float:
        """Time since something was heard, s; infinite if it never was."""
        return now_s - self._heard_s.get(name, -inf)

    def parameter(self, node: str, name: str) -> Any:
        """A node's parameter; None while it is not known."""
        return self.parameters.get(node, {}).get(name)

    def limit(self, name: str) -> float:
        """A limit of the controller; NaN while it is not known."""
        value = self.parameter(CONTROLLER, name)
        return value if isinstance(value, float) else nan

    @property
    def joints_rad(self) -> np.ndarray | None:
        """The newest joint positions, rad, shape (6,), or None."""
        return self._history.newest

    def controller(self, now_s: float) -> Controller:
        """The controller's last word, unless it is old."""
        age_s = self.age_s("status", now_s)
        if age_s <= SILENT_S:
            return self._controller
        for_s = f" for {age_s:.0f} s" if isfinite(age_s) else "; is fvs_controller_node running?"
        return Controller({}, f"no word from the controller{for_s}")

    def ball_m(self, now_s: float) -> np.ndarray | None:
        """The ball as last seen, camera frame, m, shape (3,); None if that is long ago."""
        if self._ball is None or self.age_s("ball_position", now_s) > _BALL_S:
            return None
        return self._ball[1]

    def detector(self, now_s: float) -> str:
        """The detector's sentence; empty where none runs."""
        return self._detector if self.age_s("detector", now_s) < _DETECTOR_S else ""

    def answered(self, now_s: float) -> str:
        """What was last answered to a person's wish, for a while."""
        return self._answer if now_s - self._answer_s < _ANSWER_S else ""

    def notes(self, now_s: float) -> list[str]:
        """Sentences about the page itself: what it does not know, or waits for."""
        notes = [text for text, until_s in self._notes.values() if now_s < until_s]
        return [note for note in (self.placement.note, *notes) if note]

    @property
    def field_of_view(self) -> tuple[float, float]:
        """The camera's vertical field of view, rad, and its image's width over height."""
        camera = self._intrinsics
        if camera is None or not isfinite(camera.fy):
            return _FIELD_OF_VIEW
        return 2.0 * float(np.arctan(0.5 * camera.height / camera.fy)), camera.width / camera.height

    def picture(self, now_s: float) -> np.ndarray | None:
        """The camera's picture, uint8, if it is another one than at the last call.

        A ball is circled where the image itself shows it; words say how old the picture is, or what
        it waits for.
        """
        newest, self._image = self._image, None
        if newest is not None:
            self._drawn = newest[0], self._draw(now_s, *newest[1:])
        exposed_s, image = self._drawn or (inf, picture.BLANK)
        age_s = now_s - exposed_s
        words = self.waits_for if self._drawn is None else ""
        if age_s > _OLD_PICTURE_S:
            words = f"{age_s:.0f} s old"
        if newest is None and words == self._words:
            return None
        self._words = words
        return picture.with_words(image, words) if words else image

    def _draw(self, now_s: float, stamp_s: float, image: np.ndarray) -> np.ndarray:
        seen = self._seen.rows
        near_s = np.abs(seen[:, 0] - stamp_s)
        ball_m = seen[near_s.argmin(), 1:] if near_s.min(initial=inf) <= _SAME_IMAGE_S else None
        target_m = self.controller(now_s).target_m
        return picture.draw(image, self._intrinsics, ball_m, self._ball_radius_m, target_m)
