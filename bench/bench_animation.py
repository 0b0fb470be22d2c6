"""Draws the README's animation: a simulated UR5 in the whole loop, and its error over time.

``python -m bench animation ./docs/images`` writes ``demo.gif`` there (default: out/animation).
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from cv2 import INTER_AREA, LINE_AA, polylines, resize
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from fvs_ros import ClosedLoop
from fvs_sim_node.camera import RigidPose
from fvs_sim_node.config import SimConfig
from fvs_sim_node.simulation import Simulation
from fvs_sim_node.world import Renderer

#: Of a view, and of the strip below the two and its caption, px; views are drawn finer.
VIEW_PX, STRIP_PX, CAPTION_PX, FINE = (450, 340), 200, 34, 2
#: A frame shows 13 joint states of 8 ms for 100 ms: GIF counts in 10 ms.
TICKS, FRAME_MS, DURATION_S = 13, 100, 16.0
#: The spectator, world frame.
SPECTATOR = RigidPose.looking((1.6, -0.2, 0.8), (0.25, 0.02, 0.28))
#: Of target and error, told apart by all readers; of the sky: a gradient takes a GIF's colours.
TARGET_RGB, SKY_RGB, COLOURS = (213, 94, 0), (225, 232, 240), 96
#: The dragged target's circle, and time between its messages.
DRAG_S, DRAG_M, MESSAGE_S = 4.8, 0.08, 0.032


class Story:
    """A loop, what happens to it, and the errors since the beginning."""

    def __init__(self):
        config = SimConfig.from_values({"feature": "pose", "object_tag_id": 10})
        self.loop = ClosedLoop.of_scheme("best", Simulation(config))
        self.simulation, self.kind = self.loop.simulation, self.loop.kind
        self.times_s, self.errors_m, self.events = [], [], []
        self.loop.run(0.5)  # the first images
        self.begin_s, home = self.simulation.time_s, self.loop.true_feature
        self.loop.set_target(home)
        #: Where the tag is to be, camera frame, and what can be seen now.
        self.wanted, self.caption = lambda: home, "Neither camera nor arm is calibrated."

    def happens(self, event, caption, seconds, **values):
        """Change the simulation, mark the event on the time axis, and let time pass."""
        self.events.append((self.simulation.time_s - self.begin_s, event))
        self.caption = caption
        self.simulation.configure(replace(self.simulation.config, **values))
        yield from self.passes(seconds)

    def passes(self, seconds):
        """Let time pass; yields when a frame is due."""
        for _ in range(round(seconds / self.loop.period_s)):
            self.loop.tick()
            error_m = self.kind.minus(self.loop.true_feature, self.wanted())
            self.times_s.append(self.simulation.time_s - self.begin_s)
            self.errors_m.append(max(float(np.linalg.norm(error_m[:3])), 1e-6))
            if len(self.times_s) % TICKS == 0:
                yield

    def play(self):
        """All of it."""
        loop, simulation, kind, home = self.loop, self.simulation, self.kind, self.wanted()
        yield from self.passes(1.0)
        begin_s = simulation.time_s

        def dragged():
            share = min((simulation.time_s - begin_s) / DRAG_S, 1.0)
            angle = 2.0 * np.pi * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
            right_m, up_m = DRAG_M * np.sin(angle), DRAG_M * (np.cos(angle) - 1.0)
            return kind.retract(home, np.array([right_m, up_m, 0.0, 0.0, 0.0, right_m]))

        self.wanted = dragged
        yield from self.happens("drag", "The target is dragged: the arm follows.", 0.0)
        for _ in range(round(DRAG_S / MESSAGE_S)):
            loop.set_target(dragged())
            yield from self.passes(MESSAGE_S)
        yield from self.passes(0.5)
        caption = "The camera is bumped by 25 degrees: the arm recovers."
        yield from self.happens("bump", caption, 2.8, camera_rotation_deg=(0.0, 0.0, 25.0))
        taught_z = kind.relative(loop.true_feature, simulation.true_object())
        loop.loop.go_to(loop.loop.teach(simulation.time_s))
        self.wanted = lambda: kind.absolute(taught_z, simulation.true_object())
        yield from self.happens("teach", "Taught: where the tool is, seen from the object.", 1.4)
        jumped_m = tuple(np.add(simulation.config.object_position_m, (0.05, -0.15, 0.05)))
        simulation.configure(replace(simulation.config, object_position_m=jumped_m))
        simulation.place_object()
        caption = "The object jumps: the arm repeats what it was taught."
        yield from self.happens("repeat", caption, 2.5)
        caption = "The object is carried on: the arm follows."
        yield from self.happens("follow", caption, 1.5, object_velocity_m_s=(0.0, 0.1, 0.0))
        caption, at_rest = "The object rests: so does the arm.", (0.0, 0.0, 0.0)
        yield from self.happens("rest", caption, 1.5, object_velocity_m_s=at_rest)


def photograph(story, camera):
    """A picture of the world now, with the outline of where the tag is to be, (H, W, 3)."""
    simulation, world = story.simulation, story.simulation.world
    size_px = {"image_width": FINE * VIEW_PX[0], "image_height": FINE * VIEW_PX[1]}
    config = replace(simulation.config, depth_noise=0.0, **size_px)
    own, world.renderers[0] = world.renderers[0], Renderer(world.client, config.lens())
    world.place_bodies()
    still = np.zeros(len(world.joint_names))
    rgb, depth_m = world.photograph(config, camera, still, np.random.default_rng(0))
    world.renderers[0] = own
    rgb[depth_m == 0.0] = SKY_RGB
    z = story.wanted()
    corners_m = 1.25 * world.body.points_m @ story.kind.rotation(z).T + z[:3]
    corners_m = corners_m @ simulation.camera.rotation.T + simulation.camera.position_m
    px = np.round(16.0 * config.lens().project(camera.to_own(corners_m))).astype(int)
    polylines(rgb, [px], True, TARGET_RGB, 3 * FINE, LINE_AA, 4)  # 4 bits behind the point
    return resize(rgb, VIEW_PX, interpolation=INTER_AREA)


def frame(story):
    """Both views, the caption and the error until now."""
    width, height = 2 * VIEW_PX[0], VIEW_PX[1] + STRIP_PX
    figure = Figure(figsize=(width / 100, height / 100), dpi=100)
    views = {"Scene": SPECTATOR, "Camera view; orange: target": story.simulation.camera}
    for column, (title, camera) in enumerate(views.items()):
        left = column * VIEW_PX[0]
        figure.figimage(photograph(story, camera), left, STRIP_PX, origin="upper")
        figure.text((left + 10) / width, 1 - 24 / height, title, size=12)
    figure.text(10 / width, (STRIP_PX - 26) / height, story.caption, size=15, weight="bold")
    axes = figure.add_axes((0.072, 46 / height, 0.91, (STRIP_PX - 46 - CAPTION_PX) / height))
    axes.semilogy(story.times_s, np.multiply(1e3, story.errors_m), color=np.divide(TARGET_RGB, 255))
    for moment_s, event in story.events:
        axes.axvline(moment_s, color="0.5", linewidth=1)
        axes.text(moment_s + 0.08, 1800.0, event, size=11, va="top")
    axes.set(xlim=(0.0, DURATION_S), ylim=(0.02, 2500.0), yticks=[0.1, 1, 10, 100])
    axes.set_xlabel("time (s)", labelpad=1, size=11)
    axes.set_ylabel("error (mm)", size=11)
    axes.yaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])


def main():
    path = Path(sys.argv[1] if len(sys.argv) > 1 else "out/animation") / "demo.gif"
    path.parent.mkdir(parents=True, exist_ok=True)
    story = Story()
    frames = [frame(story) for _ in story.play()]
    # One palette, and no dither: what stands still costs nothing.
    sample = Image.new("RGB", (frames[0].width, 6 * frames[0].height))
    for row, each in enumerate(frames[:: len(frames) // 6][:6]):
        sample.paste(each, (0, row * each.height))
    palette = sample.quantize(COLOURS, Image.Quantize.MEDIANCUT)
    frames = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in frames]
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=FRAME_MS, loop=0)
    print(f"{path}: {len(frames)} frames, {path.stat().st_size / 1e6:.2f} MB")
    print(f"last error {1e3 * story.errors_m[-1]:.2f} mm")


if __name__ == "__main__":
    main()
