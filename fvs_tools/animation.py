"""``python -m fvs_tools.animation FILE.gif``: the loop at work, as a short animation.

A target is dragged and the arm follows; then the camera is turned and moved, and the arm recovers.
It shows a run of the simulated loop: rendered images, real detection, no ROS.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fvs_ros.arguments import Parser
from fvs_ros.camera import Intrinsics
from fvs_sim_node.camera import CameraPose
from fvs_sim_node.simulation import SimConfig, Simulation
from fvs_sim_node.world import Renderer
from fvs_tools.closed_loop import ClosedLoop

_SIZE = Intrinsics(320, 240, 300.0, 300.0, 160.0, 120.0)
#: Below the two pictures: the curve of the distance, up to this many mm.
_STRIP_PX, _MOST_MM = 90, 100.0
#: Targets a second; every second one is a frame of the film.
_RATE_HZ = 25.0
_TARGET, _BALL, _INK = (30, 160, 60), (200, 40, 40), (40, 40, 40)


class Film:
    """Runs the loop and draws it."""

    def __init__(self) -> None:
        self.simulation = Simulation(SimConfig(seed=1))
        self.loop = ClosedLoop.of_scheme("best", self.simulation)
        self._renderer = Renderer(self.simulation.world.client, _SIZE)
        self._pose = CameraPose.looking((-0.75, 1.15, 0.95), (0.25, 0.05, 0.35))
        self.frames: list[np.ndarray] = []
        self._errors_mm: list[float] = []
        self._bumped_at: int | None = None

    def run(self) -> None:
        """Drag a target, rest, bump the camera, recover."""
        self.loop.run(0.5)
        share = np.linspace(0.0, 1.0, 100)
        angle = 2.0 * np.pi * share * (2.0 - share)  # slows down towards the end
        circle_m = 0.11 * np.stack([np.sin(angle), 1.0 - np.cos(angle), 0.36 * share], axis=1)
        dragged_m = self.loop.ball_m + circle_m
        self._follow(dragged_m)
        self._follow(dragged_m[[-1] * 30])
        # A target near the ball's true place, in the frame of the moved camera.
        camera = self.simulation.camera
        place_m = camera.rotation @ dragged_m[-1] + camera.position_m
        moved = camera.turned(np.array([0.0, 0.0, 0.5])).moved(np.array([0.04, 0.03, 0.0]))
        self.simulation.camera = moved
        self._bumped_at = len(self._errors_mm)
        self._follow(np.tile(moved.to_camera(place_m) + [-0.1, 0.05, 0.0], (60, 1)))

    def _follow(self, targets_m: np.ndarray) -> None:
        """Give targets, camera frame, shape (n, 3), one after the other, and draw."""
        last_m: np.ndarray | None = None
        for number, target_m in enumerate(targets_m):
            if last_m is None or not np.array_equal(last_m, target_m):
                self.loop.set_target(target_m)
            last_m = target_m
            self.loop.run(1.0 / _RATE_HZ)
            if number % 2 == 0:
                self._errors_mm.append(1e3 * float(np.linalg.norm(self.loop.ball_m - target_m)))
                self.frames.append(self._draw(target_m))

    def _draw(self, target_m: np.ndarray) -> np.ndarray:
        view = self._renderer.render(self._pose)[0]
        seen = self._renderer.render(self.simulation.camera)[0]
        for place_m, colour, radius in ((target_m, _TARGET, 9), (self.loop.ball_m, _BALL, 2)):
            at = np.round(_SIZE.project(place_m)).astype(int).tolist()
            cv2.circle(seen, at, radius, colour, 2, cv2.LINE_AA)
        _write(view, "the robot", (8, 18))
        _write(seen, "its camera" if self._bumped_at is None else "its camera, bumped", (8, 18))
        strip = np.full((_STRIP_PX, 2 * _SIZE.width, 3), 255, np.uint8)
        u = np.linspace(6, 2 * _SIZE.width - 6, 95)  # of all frames
        up = np.minimum(np.array(self._errors_mm) / _MOST_MM, 1.0)
        points = np.stack([u[: len(up)], _STRIP_PX - 6 - (_STRIP_PX - 12) * up], axis=1)
        cv2.polylines(strip, [points.round().astype(np.int32)], False, _BALL, 2, cv2.LINE_AA)
        if self._bumped_at is not None:
            at_u = round(u[self._bumped_at])
            cv2.line(strip, (at_u, 0), (at_u, _STRIP_PX), _INK, 1)
            _write(strip, "camera bumped", (at_u + 4, 16))
        _write(strip, f"distance to the target: {self._errors_mm[-1]:.0f} mm", (8, 16))
        return np.vstack([np.hstack([view, seen]), strip])


def _write(image: np.ndarray, text: str, at: tuple[int, int]) -> None:
    cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.48, _INK, 1, cv2.LINE_AA)


def save(frames: list[np.ndarray], path: Path) -> None:
    """Write frames, uint8, (H, W, 3), as a GIF that repeats."""
    from PIL import Image

    palette = Image.fromarray(frames[-1]).quantize(128)  # colours
    images = [
        Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE)
        for frame in frames
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    look: dict[str, Any] = {"duration": round(2e3 / _RATE_HZ), "loop": 0, "optimize": True}
    images[0].save(path, save_all=True, append_images=images[1:], **look)


def main(argv: list[str] | None = None) -> int:
    """Make the animation."""
    parser = Parser("python -m fvs_tools.animation", __doc__ or "")
    parser.add_argument("file", type=Path, help="where to write it, such as docs/images/demo.gif")
    path = parser.parse_args(argv).file
    film = Film()
    film.run()
    save(film.frames, path)
    print(f"{path}: {len(film.frames)} frames, {path.stat().st_size / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
