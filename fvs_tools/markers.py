"""What a viewer shows of the loop: ball, trail, target with its distance, predicted position.

Everything lies in the camera's optical frame, where the loop works, and lives a moment only: what
is not said again vanishes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite

import numpy as np

from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.params import Parameter
from fvs_ros.status import number, vector

NODE = "fvs_markers_node"

PARAMETERS = (
    Parameter("feature_frame", CAMERA_FRAME, "frame of ball and target"),
    Parameter("rate_hz", 10.0, "how often the markers are sent", minimum=1.0, maximum=30.0),
    Parameter("trail_s", 10.0, "how much of the ball's way is shown", minimum=0.1, maximum=120.0),
    Parameter("ball_radius_m", 0.04, "radius of the ball", minimum=0.005, maximum=0.2),
)

#: What was not said again for so long is not shown any more, s.
FRESH_S = 0.5
_RED, _GREEN, _BLUE = (0.85, 0.1, 0.1), (0.2, 0.75, 0.35), (0.1, 0.45, 0.7)
_YELLOW, _WHITE = (0.95, 0.75, 0.1), (1.0, 1.0, 1.0)
_LINE_M, _TEXT_M = 0.006, 0.035


def lifetime_s(rate_hz: float) -> float:
    """How long a viewer shows a marker that is not said again, s: no seldom one blinks."""
    return max(FRESH_S, 2.0 / rate_hz)


@dataclass(frozen=True)
class Shape:
    """One thing to show.

    Parameters
    ----------
    name : str
        Which.
    kind : str
        ``sphere``, ``text`` or ``line``.
    points_m : ndarray, shape (n, 3)
        A line's points; else the one place, m.
    size_m : float
        Diameter of a sphere, height of a text, width of a line, m.
    colour : tuple of float
        Red, green, blue, opacity; 0 to 1.
    text : str
        What a text says.
    """

    name: str
    kind: str
    points_m: np.ndarray
    size_m: float
    colour: tuple[float, float, float, float]
    text: str = ""


class Scene:
    """Remembers what was heard, and tells what to show.

    Parameters
    ----------
    ball_radius_m : float
        Radius of the ball, m.
    trail_s : float
        Length of its trail, s.
    """

    def __init__(self, ball_radius_m: float, trail_s: float) -> None:
        self._diameter_m = 2.0 * ball_radius_m
        self._trail_s = trail_s
        self._trail: deque[tuple[float, np.ndarray]] = deque()
        self._status: Mapping[str, str] = {}
        self._status_s = float("-inf")

    def add_ball(self, now_s: float, position_m: np.ndarray) -> None:
        """Take a ball position, heard at a moment of the steady clock."""
        self._trail.append((now_s, position_m))
        self._forget(now_s)

    def add_status(self, now_s: float, values: Mapping[str, str]) -> None:
        """Take the key numbers of the controller's status."""
        self._status, self._status_s = values, now_s

    def shapes(self, now_s: float) -> list[Shape]:
        """What to show now."""
        self._forget(now_s)
        found = []
        if self._trail and now_s - self._trail[-1][0] < FRESH_S:
            ball_m = self._trail[-1][1][None]
            found.append(Shape("ball", "sphere", ball_m, self._diameter_m, (*_RED, 1.0)))
        if len(self._trail) > 1:
            way_m = np.array([position_m for _, position_m in self._trail])
            found.append(Shape("trail", "line", way_m, _LINE_M, (*_YELLOW, 0.9)))
        if now_s - self._status_s < FRESH_S:
            found += self._told()
        return found

    def _told(self) -> list[Shape]:
        """What the controller's status tells."""
        found = []
        target_m, predicted_m = (
            vector(self._status, f"{name}_{{}}_m") for name in ("target", "position")
        )
        if target_m is not None:
            found.append(
                Shape("target", "sphere", target_m[None], self._diameter_m, (*_GREEN, 0.4))
            )
            above_m = target_m - [0.0, 0.75 * self._diameter_m + _TEXT_M, 0.0]  # y points down
            found.append(
                Shape("distance", "text", above_m[None], _TEXT_M, (*_WHITE, 1.0), self._words())
            )
        if predicted_m is not None:
            size_m = 0.4 * self._diameter_m
            found.append(Shape("predicted", "sphere", predicted_m[None], size_m, (*_BLUE, 0.9)))
        return found

    def _words(self) -> str:
        error_m = number(self._status, "error_m")
        distance = f"{1e3 * error_m:.1f} mm" if isfinite(error_m) else "no ball"
        state = self._status.get("state", "")
        return distance if state in ("", "SERVOING") else f"{distance}, {state.lower()}"

    def _forget(self, now_s: float) -> None:
        while self._trail and now_s - self._trail[0][0] > self._trail_s:
            self._trail.popleft()
