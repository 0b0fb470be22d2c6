"""Full camera frames from a process of its own, so that the real-time loop never waits for one.

A full frame takes tens of milliseconds to draw; a robot's joint states come every eight. The
worker has its own copy of the scene and is told where joints and camera were at an exposure. It
draws one frame at a time and skips exposures while it is busy, as a camera with too little
bandwidth would. Frames are handed over in shared memory: two megabytes through a pipe would make
the loop wait for a process that gets what the loop leaves of the processor.
"""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import signal
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext

import numpy as np

from fvs_ros.background import step_back
from fvs_ros.camera import Intrinsics
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


class _SharedFrame:
    """Room for one frame that two processes see.

    Parameters
    ----------
    context : multiprocessing context
        Of the processes.
    intrinsics : Intrinsics
        The full image.
    """

    def __init__(self, context: SpawnContext, intrinsics: Intrinsics) -> None:
        self._shape = intrinsics.height, intrinsics.width
        pixels = intrinsics.height * intrinsics.width
        self._rgb = context.RawArray(ctypes.c_uint8, 3 * pixels)
        self._depth_m = context.RawArray(ctypes.c_float, pixels)

    def put(self, frame: Frame) -> None:
        """Copy a frame in."""
        room = self.view(frame.stamp_s)
        room.rgb[:], room.depth_m[:] = frame.rgb, frame.depth_m

    def view(self, stamp_s: float) -> Frame:
        """The frame that is in, exposed at a stamp, s; not a copy."""
        return Frame(
            stamp_s,
            np.ctypeslib.as_array(self._rgb).reshape(*self._shape, 3),
            np.ctypeslib.as_array(self._depth_m).reshape(self._shape),
        )


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
        self._shared = _SharedFrame(context, config.intrinsics)
        self._process = context.Process(
            target=_work, args=(theirs, self._shared, config), daemon=True
        )
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
        """The frame asked for, once it is drawn; overwritten after the next exposure."""
        if not self._busy or not self._pipe.poll():
            return None
        self._busy = False
        return self._shared.view(self._pipe.recv())

    def close(self) -> None:
        """End the process."""
        self._pipe.close()
        self._process.join(_STOP_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _work(pipe: Connection, shared: _SharedFrame, config: SimConfig) -> None:
    # Ctrl-C reaches the whole terminal group; this process ends with its pipe.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    step_back(own_session=True)
    world = build_world(config)
    renderer = Renderer(world.client, config.intrinsics)
    rng = np.random.default_rng(config.seed)
    with contextlib.suppress(EOFError, OSError):  # the other end was closed
        while True:
            wanted: _Exposure = pipe.recv()
            if wanted.covered:
                frame = Frame.black(wanted.stamp_s, config.intrinsics)
            else:
                world.reset(wanted.joints_rad)
                world.place_ball()
                rgb, depth_m = renderer.render(wanted.camera)
                depth_m = add_depth_noise(depth_m, config.intrinsics.fx, rng, wanted.depth_noise)
                frame = Frame(wanted.stamp_s, rgb, depth_m)
            shared.put(frame)
            pipe.send(wanted.stamp_s)
    world.close()
