"""Collects what comes over the topics, as plain values, and makes snapshots of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from math import inf, isfinite, nan
from typing import Any

import numpy as np

from fvs_ros.apps.dashboard import picture, view
from fvs_ros.apps.dashboard.placement import CameraPlacement, Pose
from fvs_ros.core.camera import Intrinsics
from fvs_ros.core.history import JointHistory
from fvs_ros.core.joints import N_JOINTS
from fvs_ros.core.status import SILENT_S

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
    """All that is known, from the newest messages.

    Parameters
    ----------
    history_s, trail_s : float
        Length of the curves and of the ball's trail, s.
    ball_radius_m : float
        Radius of the ball, m.
    """

    def __init__(self, history_s: float, trail_s: float, ball_radius_m: float) -> None:
        self._trail_s = trail_s
        self._ball_radius_m = ball_radius_m
        self._controller = view.ControllerView()
        self._heard_s: dict[str, float] = {}
        self._history = JointHistory()
        self._velocity = np.full(N_JOINTS, nan)
        self._ball: tuple[float, np.ndarray] | None = None  # exposure's stamp and position
        self._learned_from = -inf
        self._trail = Trace(trail_s, 3)
        self._error = Trace(history_s, 4)
        self._speed = Trace(history_s, N_JOINTS)
        self._ratio = Trace(history_s, 1)
        self._exponent = Trace(history_s, 3)
        self._seen = Trace(trail_s + _LATEST_IMAGE_S, 3)  # the trail, by the exposures' stamps
        self._targets: deque[tuple[float, np.ndarray | None]] = deque()  # since when which
        self._image: tuple[float, float, np.ndarray] | None = None
        self._drawn: tuple[float, np.ndarray] | None = None  # the last image, and its exposure
        self._said_age_s = 0
        self._intrinsics: Intrinsics | None = None
        self._answer, self._answer_s = "", -inf
        self._notes: dict[str, tuple[str, float]] = {}  # text, and until when
        self._detector = ""
        self.placement = CameraPlacement()
        self.limit_rad_s = nan
        self.max_ages_s: Mapping[str, float] = {}
        self.simulator: Mapping[str, Any] | None = None

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
        self._trail.add(now_s, position_m)

    def add_status(self, now_s: float, values: Mapping[str, str], sentence: str) -> None:
        """Tell the controller's status."""
        self._heard_s["status"] = now_s
        self._controller = controller = view.ControllerView.of(values, sentence)
        error = controller.error_xyz_m
        if error is not None:
            parts = 1e3 * np.abs(np.concatenate([[controller.error_m], error]))
            self._error.add(now_s, np.maximum(parts, _SMALLEST_MM))
        # Without a ball nothing is judged: what the estimator goes on saying is of before.
        if now_s - self._heard_s.get("ball_position", -inf) < _JUDGED_S:
            ratio = controller.prediction_error_ratio
            self._ratio.add(now_s, np.maximum([ratio], _SMALLEST_RATIO))
        if controller.exponents is not None:
            self._exponent.add(now_s, controller.exponents)
        self._targets.append((now_s, controller.target_m))
        while self._targets[0][0] < now_s - _LATEST_IMAGE_S:
            self._targets.popleft()

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
        before = self.placement.pose
        self.placement.tell(pose)
        if before is not None and not np.allclose(before.rotation, pose.rotation, atol=1e-4):
            self._trail.clear()
            self._seen.clear()

    def note(self, name: str, text: str, until_s: float = inf) -> None:
        """Tell how the page itself is, until a time or until told otherwise; empty if well."""
        self._notes[name] = text, until_s

    def answer(self, now_s: float, text: str) -> None:
        """Tell what was answered to a person's wish."""
        self._answer, self._answer_s = text, now_s

    # --- what is known ---

    @property
    def joints_rad(self) -> np.ndarray | None:
        """The newest joint positions, rad, shape (6,), or None."""
        return self._history.newest

    def controller(self, now_s: float) -> view.ControllerView:
        """The controller's last word, unless it is old."""
        if now_s - self._heard_s.get("status", -inf) > SILENT_S:
            return view.ControllerView()
        return self._controller

    def ball_m(self, now_s: float) -> np.ndarray | None:
        """The ball as last seen, camera frame, m, shape (3,); None if that is long ago."""
        if self._ball is None or now_s - self._heard_s["ball_position"] > _BALL_S:
            return None
        return self._ball[1]

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
        if now_s - self._heard_s.get("joint_states", -inf) < SILENT_S:
            self._speed.add(now_s, np.abs(self._velocity))

    def snapshot(self, now_s: float, tour: bool) -> view.Snapshot:
        """Everything at this moment; an image is given out once."""
        controller = self.controller(now_s)
        heard_s = {name: now_s - heard for name, heard in self._heard_s.items()}
        banner = view.banner_of(controller)
        if controller.silent and "status" in heard_s:
            banner = replace(
                banner, sentence=f"no word from the controller for {heard_s['status']:.0f} s"
            )
        detector_s = heard_s.get("detector", inf)
        notes = [self.placement.note]
        notes += [text for text, until_s in self._notes.values() if now_s < until_s]
        drawn = self._picture(now_s, controller.silent)
        return view.Snapshot(
            banner=banner,
            controller=controller,
            lamps=view.lamps_of(controller, heard_s, self.max_ages_s),
            details=view.details_of(controller, self._detector if detector_s < _DETECTOR_S else ""),
            joints_rad=self.joints_rad,
            camera=self.placement.pose,
            table=self.placement.told,
            notes=tuple(note for note in notes if note),
            ball_m=self.ball_m(now_s),
            trail_m=self._trail.window(now_s)[:, 1:],
            curves=view.Curves(
                self._error.window(now_s),
                self._speed.window(now_s),
                self._ratio.window(now_s),
                self._exponent.window(now_s),
            ),
            limit_rad_s=self.limit_rad_s,
            picture=drawn,
            picture_old_s=self._said_age_s,
            field_of_view=self._field_of_view(),
            answer=self._answer if now_s - self._answer_s < _ANSWER_S else "",
            tour=tour,
            simulator=self.simulator,
        )

    def picture_age_s(self, now_s: float) -> float:
        """Time since the newest image was exposed, s; infinite if there was none."""
        newest = self._image or self._drawn
        return inf if newest is None else now_s - newest[0]

    def _picture(self, now_s: float, silent: bool) -> np.ndarray | None:
        """The newest image, once; and the last one again as often as its age is another one."""
        newest, self._image = self._image, None
        if newest is not None:
            self._drawn = newest[0], self._draw(*newest, silent)
        if self._drawn is None:
            return None
        exposed_s, drawn = self._drawn
        age_s = now_s - exposed_s
        said_s, self._said_age_s = self._said_age_s, round(age_s) if age_s > _OLD_PICTURE_S else 0
        if self._said_age_s and (newest is not None or self._said_age_s != said_s):
            return picture.darkened(drawn)
        return drawn if newest is not None else None

    def _draw(
        self, exposed_s: float, stamp_s: float, image: np.ndarray, silent: bool
    ) -> np.ndarray:
        """An image with what was so when it was exposed: it may have come late."""
        target_m = None if silent else self._target_at(exposed_s)
        seen = self._seen.rows
        near = np.abs(seen[:, 0] - stamp_s)
        ball_m = seen[near.argmin(), 1:] if near.min(initial=inf) <= _SAME_IMAGE_S else None
        since = seen[:, 0] - stamp_s
        trail_m = seen[(since >= -self._trail_s) & (since <= _SAME_IMAGE_S), 1:]
        return picture.draw(image, self._intrinsics, ball_m, self._ball_radius_m, target_m, trail_m)

    def _target_at(self, steady_s: float) -> np.ndarray | None:
        """The controller's target at a time; None where that is longer ago than is known."""
        told = [target_m for told_s, target_m in self._targets if told_s <= steady_s]
        return told[-1] if told else None

    def _field_of_view(self) -> tuple[float, float]:
        camera = self._intrinsics
        if camera is None or not isfinite(camera.fy):
            return _FIELD_OF_VIEW
        return 2.0 * float(np.arctan(0.5 * camera.height / camera.fy)), camera.width / camera.height
