"""Things that stand around the arm: what the camera sees of them, and where."""

from __future__ import annotations

from dataclasses import dataclass

BALL_RGBA = (0.86, 0.07, 0.06, 1.0)


@dataclass(frozen=True)
class SceneObject:
    """A thing that only the camera sees.

    Parameters
    ----------
    kind : str
        ``sphere`` or ``box``.
    position_m : tuple of float
        Centre, world frame, m.
    size_m : tuple of float
        Radius of a sphere (one number), or edge lengths of a box (three), m.
    rgba : tuple of float
        Colour, 0 to 1.
    """

    kind: str
    position_m: tuple[float, float, float]
    size_m: tuple[float, ...]
    rgba: tuple[float, float, float, float] = BALL_RGBA


#: A table of light wood, low enough for the ball to pass over, and a foot for the arm.
TABLE = (
    SceneObject("box", (-0.30, 0.0, -0.22), (1.40, 1.20, 0.04), (0.87, 0.80, 0.68, 1.0)),
    SceneObject("box", (0.0, 0.0, -0.10), (0.20, 0.20, 0.20), (0.45, 0.50, 0.56, 1.0)),
)
