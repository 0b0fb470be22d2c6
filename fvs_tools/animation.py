"""``python -m fvs_tools.animation FILE.gif``: the loop at work, as a short animation.

A target is dragged and the arm follows; then the camera is turned and moved, and the arm recovers.
What is drawn is a run of the simulated loop: rendered images, real detection, no ROS.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from fvs_ros.arguments import Parser
from fvs_ros.camera import Intrinsics
from fvs_sim_node.camera import CameraPose
from fvs_sim_node.simulation import SimConfig, Simulation
from fvs_sim_node.world import Renderer
from fvs_tools.closed_loop import ClosedLoop

_SIZE = Intrinsics(320, 240, 300.0, 300.0, 160.0, 120.0)
_STRIP_PX, _MARGIN_PX = 90, 6
_FRAMES_HZ, _UPDATES_HZ = 12.5, 25.0
_DRAG_S, _REST_S, _AFTER_S = 4.0, 1.2, 2.4
#: The camera is turned about its optical axis and moved, rad and m.
_TURN_RAD, _SHIFT_M = (0.0, 0.0, 0.5), (0.04, 0.03, 0.0)
_MOST_MM = 100.0
_TARGET, _BALL, _INK = (30, 160, 60), (200, 40, 40), (40, 40, 40)
#: Colours of the file.
_COLOURS = 128


class Film:
    """Runs the loop and draws it."""

    def __init__(self) -> None:
        self.simulation = Simulation(SimConfig(seed=1))
        self.loop = ClosedLoop.of_scheme("best", self.simulation)
        self._renderer = Renderer(self.simulation.world.client, _SIZE)
        self._pose = CameraPose.looking((0.75, -1.15, 0.95), (-0.25, -0.05, 0.35))
        self.frames: list[np.ndarray] = []
        self._errors_mm: list[float] = []
        self._bumped_at: int | None = None
        self._target_m = self.loop.ball_m

    def run(self) -> None:
        """Drag a target, rest, bump the camera, recover."""
        self.loop.run(0.5)
        start_m = self.loop.ball_m

        def dragged(time_s: float) -> np.ndarray:
            share = time_s / _DRAG_S
            angle = 2.0 * np.pi * share * (2.0 - share)  # slows down towards the end
            return start_m + [0.11 * np.sin(angle), 0.11 * (1.0 - np.cos(angle)), 0.04 * share]

        self._shoot(_DRAG_S, dragged)
        last_m = dragged(_DRAG_S)
        self._shoot(_REST_S, lambda _time_s: last_m)
        # In the moved camera's view, a target near the place where the ball is in the room.
        place_m = self.simulation.camera.rotation @ last_m + self.simulation.camera.position_m
        turned = self.simulation.camera.turned(np.array(_TURN_RAD))
        self.simulation.camera = turned.moved(np.array(_SHIFT_M))
        self._bumped_at = len(self._errors_mm)
        goal_m = self.simulation.camera.to_camera(place_m) + [-0.1, 0.05, 0.0]
        self._shoot(_AFTER_S, lambda _time_s: goal_m)

    def _shoot(self, seconds: float, target_at) -> None:
        period_s = self.loop.period_s
        ticks, update = round(seconds / period_s), round(1.0 / _UPDATES_HZ / period_s)
        shot = round(1.0 / _FRAMES_HZ / period_s)
        last: np.ndarray | None = None
        for tick in range(ticks):
            if tick % update == 0:
                self._target_m = target_at(tick * period_s)
                if last is None or not np.array_equal(last, self._target_m):
                    self.loop.set_target(self._target_m)
                last = self._target_m
            self.loop.tick()
            if tick % shot == 0:
                error_m = np.linalg.norm(self.loop.ball_m - self._target_m)
                self._errors_mm.append(1e3 * float(error_m))
                self.frames.append(self._draw())

    def _draw(self) -> np.ndarray:
        view = self._renderer.render(self._pose)[0]
        seen = self._renderer.render(self.simulation.camera)[0]
        for place_m, colour, radius in ((self._target_m, _TARGET, 9), (self.loop.ball_m, _BALL, 2)):
            u, v = _SIZE.project(place_m)
            cv2.circle(seen, (round(float(u)), round(float(v))), radius, colour, 2, cv2.LINE_AA)
        bumped = self._bumped_at is not None
        _write(view, "the robot", (8, 18))
        _write(seen, "its camera, bumped" if bumped else "its camera", (8, 18))
        return np.vstack([np.hstack([view, seen]), self._strip()])

    def _strip(self) -> np.ndarray:
        strip = np.full((_STRIP_PX, 2 * _SIZE.width, 3), 255, np.uint8)
        count = round((_DRAG_S + _REST_S + _AFTER_S) * _FRAMES_HZ)
        across = np.linspace(_MARGIN_PX, 2 * _SIZE.width - _MARGIN_PX, count)
        height = _STRIP_PX - 2 * _MARGIN_PX
        up = np.minimum(np.array(self._errors_mm) / _MOST_MM, 1.0) * height
        points = np.stack([across[: len(up)], _STRIP_PX - _MARGIN_PX - up], axis=1)
        cv2.polylines(strip, [points.round().astype(np.int32)], False, _BALL, 2, cv2.LINE_AA)
        if self._bumped_at is not None:
            u = round(float(across[self._bumped_at]))
            cv2.line(strip, (u, 0), (u, _STRIP_PX), _INK, 1)
            _write(strip, "camera bumped", (u + 4, 16))
        _write(strip, f"distance to the target: {self._errors_mm[-1]:.0f} mm", (8, 16))
        return strip


def _write(image: np.ndarray, text: str, at: tuple[int, int]) -> None:
    cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.48, _INK, 1, cv2.LINE_AA)


def save(frames: list[np.ndarray], path: Path) -> None:
    """Write frames, uint8, (H, W, 3), as a GIF that repeats."""
    from PIL import Image

    palette = Image.fromarray(frames[-1]).quantize(_COLOURS)
    images = [
        Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE)
        for frame in frames
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    images[0].save(
        path,
        save_all=True,
        append_images=images[1:],
        duration=round(1e3 / _FRAMES_HZ),
        loop=0,
        optimize=True,
    )


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
