"""Renders full camera frames in a separate process, so that the real-time loop never waits.

A full frame takes tens of milliseconds to draw, while joint states are due every eight. The worker
has its own copy of the scene and draws one frame at a time. While busy it skips exposures, like a
camera with too little bandwidth. Frames pass through shared memory: a pipe for two megabytes would
make the loop wait for this process, which has a lower priority.
"""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import os
import signal
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from fvs_sim_node.config import SimConfig
from fvs_sim_node.simulation import Observation
from fvs_sim_node.world import World


class FrameWorker:
    """Draws frames of a simulated scene in parallel; ``config.seed`` seeds the image noise."""

    def __init__(self, config: SimConfig) -> None:
        self._config = replace(config, gui=False)
        context = multiprocessing.get_context("spawn")
        pixels = config.image_width * config.image_height
        self._memory = (
            context.RawArray(ctypes.c_uint8, 3 * pixels),
            context.RawArray(ctypes.c_float, pixels),
        )
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=_work, args=(theirs, self._memory, self._config), daemon=True
        )
        self._process.start()
        theirs.close()
        self._busy = False

    def expose(self, observation: Observation, config: SimConfig) -> bool:
        """Request a frame; False if it is skipped, because the worker is still busy."""
        if self._busy:
            return False
        self._pipe.send((observation, config))
        self._busy = True
        return True

    def finished(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Colours and depths asked for, once drawn; overwritten after the next exposure."""
        if not self._busy or not self._pipe.poll():
            return None
        self._pipe.recv()
        self._busy = False
        return _arrays(self._memory, self._config)

    def close(self) -> None:
        """Kill the process: it has nothing to save, and its low priority would delay its end."""
        self._pipe.close()
        self._process.kill()


def _arrays(memory: tuple[Any, Any], config: SimConfig) -> tuple[np.ndarray, np.ndarray]:
    """Colours and depth in the shared memory; no copies."""
    shape = (config.image_height, config.image_width)
    rgb, depth_m = (np.ctypeslib.as_array(part) for part in memory)
    return rgb.reshape(*shape, 3), depth_m.reshape(shape)


def _work(pipe: Connection, memory: tuple[Any, Any], config: SimConfig) -> None:
    # Ctrl-C reaches the whole terminal group; this process ends with its pipe.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    world = World(config)
    os.nice(10)  # images must not slow down the control loop
    rng = np.random.default_rng(config.seed)
    rgb, depth_m = _arrays(memory, config)
    with contextlib.suppress(EOFError, OSError):  # the other end was closed
        while True:
            observation, config = pipe.recv()
            world.reset(observation.joints_rad)
            world.object_pose = observation.object_pose
            world.place_bodies()
            rgb[:], depth_m[:] = world.photograph(
                config,
                observation.camera,
                observation.velocities_rad_s,
                rng,
                number=observation.number,
            )
            pipe.send(None)
    world.close()
