"""Visual shapes of PyBullet; importing this says how to install it."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from fvs_sim_node.robot import NEEDS_PYBULLET


@contextmanager
def without_chatter() -> Iterator[None]:
    """Drop what PyBullet's C code prints, such as when it was built."""
    flush, nowhere = ctypes.CDLL(None).fflush, os.open(os.devnull, os.O_WRONLY)
    kept = {fd: os.dup(fd) for fd in (1, 2) if os.path.exists(f"/proc/self/fd/{fd}")}
    flush(None)
    for fd in kept:
        os.dup2(nowhere, fd)
    try:
        yield
    finally:
        flush(None)
        for fd, own in kept.items():
            os.dup2(own, fd)
            os.close(own)
        os.close(nowhere)


try:
    with without_chatter():
        import pybullet
        from pybullet_utils.bullet_client import BulletClient
except ImportError as error:
    raise ImportError(f"{NEEDS_PYBULLET} ({error})") from None

__all__ = ["BulletClient", "box", "pybullet", "sphere", "without_chatter"]


def box(
    client: BulletClient,
    half_m: np.ndarray,
    rgba: tuple[float, ...],
    middle_m: tuple[float, ...] = (0.0, 0.0, 0.0),
) -> int:
    """A box with half its edges, about a middle."""
    return client.createVisualShape(
        pybullet.GEOM_BOX, halfExtents=half_m, rgbaColor=rgba, visualFramePosition=middle_m
    )


def sphere(client: BulletClient, radius_m: float, rgba: tuple[float, ...]) -> int:
    """A sphere: PyBullet draws its own 5 % too small."""
    rows, columns = 18, 36
    polar, azimuth = np.mgrid[: rows + 1, :columns] * np.pi / rows
    normals = np.stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    )
    row, column = np.mgrid[:rows, :columns]
    here, beside = row * columns + column, row * columns + (column + 1) % columns
    below, across = here + columns, beside + columns
    triangles = np.stack([here, below, across, here, across, beside], axis=-1)
    # Its faces lie inside its corners: with this factor the outline's area is the sphere's.
    vertices = 1.0035 * radius_m * normals.reshape(3, -1).T
    return client.createVisualShape(
        pybullet.GEOM_MESH,
        vertices=vertices.tolist(),
        indices=triangles.ravel().tolist(),
        normals=normals.reshape(3, -1).T.tolist(),
        rgbaColor=rgba,
    )
