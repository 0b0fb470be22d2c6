"""Full camera frames from a process of its own, so that the real-time loop never waits for one.

A full frame takes tens of milliseconds to draw; a robot's joint states come every eight. The
worker has its own copy of the scene and is told where joints and camera were at an exposure. It
draws one frame at a time and skips exposures while it is busy, as a camera with too little
bandwidth would.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
from dataclasses import dataclass
from multiprocessing.connection import Connection

import numpy as np

from fvs_ros.core.background import step_back
from fvs_sim_node.depth_noise import add_depth_noise
from fvs_sim_node.rendering import CameraPose, Renderer
from fvs_sim_node.simulation import Frame, SimConfig, build_world

_STOP_S = 2.0


@dataclass(frozen=True)
class _Exposure:
    stamp_s: float
    joints_rad: np.ndarray
    camera: CameraPose
    depth_noise: float
    covered: bool


class FrameWorker:
    """Draws frames of a simulated scene beside the simulation.

    Parameters
    ----------
    config : SimConfig
        The scene; its seed also seeds the frames' depth noise.
    """

    def __init__(self, config: SimConfig) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs, config), daemon=True)
        self._process.start()
        theirs.close()
        self._busy = False

    def expose(
        self,
        stamp_s: float,
        joints_rad: np.ndarray,
        camera: CameraPose,
        depth_noise: float,
        covered: bool = False,
    ) -> bool:
        """Ask for a frame.

        Parameters
        ----------
        stamp_s : float
            Exposure, s.
        joints_rad : ndarray, shape (6,)
            Joints at the exposure, rad.
        camera : CameraPose
            Camera at the exposure.
        depth_noise : float
            Factor on the depth camera's noise.
        covered : bool
            Whether the lens was covered.

        Returns
        -------
        bool
            False if the worker is still busy with another frame: this one is skipped.
        """
        if self._busy:
            return False
        self._pipe.send(_Exposure(stamp_s, joints_rad, camera, depth_noise, covered))
        self._busy = True
        return True

    def finished(self) -> Frame | None:
        """The frame asked for, once it is drawn."""
        if not self._busy or not self._pipe.poll():
            return None
        self._busy = False
        return self._pipe.recv()

    def close(self) -> None:
        """End the process."""
        self._pipe.close()
        self._process.join(_STOP_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _work(pipe: Connection, config: SimConfig) -> None:
    # Ctrl-C reaches the whole terminal group; this process ends with its pipe.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    step_back(own_session=True)
    world = build_world(config)
    renderer = Renderer(world.client, config.intrinsics)
    rng = np.random.default_rng(config.seed)
    with contextlib.suppress(EOFError, BrokenPipeError):
        while True:
            wanted: _Exposure = pipe.recv()
            if wanted.covered:
                pipe.send(Frame.black(wanted.stamp_s, config.intrinsics))
                continue
            world.reset(wanted.joints_rad)
            world.place_ball()
            rgb, depth_m = renderer.render(wanted.camera)
            depth_m = add_depth_noise(depth_m, config.intrinsics.fx, rng, wanted.depth_noise)
            pipe.send(Frame(wanted.stamp_s, rgb, depth_m))
    world.close()
