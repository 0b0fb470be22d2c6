"""A fine sphere mesh by subdivision of an icosahedron."""

from __future__ import annotations

import numpy as np

_GOLDEN = (1.0 + 5.0**0.5) / 2.0
_CORNERS = [
    (-1, _GOLDEN, 0), (1, _GOLDEN, 0), (-1, -_GOLDEN, 0), (1, -_GOLDEN, 0),
    (0, -1, _GOLDEN), (0, 1, _GOLDEN), (0, -1, -_GOLDEN), (0, 1, -_GOLDEN),
    (_GOLDEN, 0, -1), (_GOLDEN, 0, 1), (-_GOLDEN, 0, -1), (-_GOLDEN, 0, 1),
]  # fmt: skip
_FACES = [
    (0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11),
    (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6), (7, 1, 8),
    (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9),
    (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1),
]  # fmt: skip


def icosphere(subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    """Mesh of the unit sphere.

    Parameters
    ----------
    subdivisions : int
        How often each triangle is cut in four; 3 gives 1280 triangles.

    Returns
    -------
    vertices : ndarray, shape (V, 3)
        Points on the sphere, which are also their normals.
    triangles : ndarray of int, shape (T, 3)
        Vertex numbers, counter-clockwise seen from outside.
    """
    vertices = [np.array(corner) / np.linalg.norm(corner) for corner in _CORNERS]
    triangles = list(_FACES)
    for _ in range(subdivisions):
        middles: dict[tuple[int, int], int] = {}

        def middle(a: int, b: int, middles: dict[tuple[int, int], int] = middles) -> int:
            key = (min(a, b), max(a, b))
            if key not in middles:
                point = vertices[a] + vertices[b]
                middles[key] = len(vertices)
                vertices.append(point / np.linalg.norm(point))
            return middles[key]

        finer: list[tuple[int, int, int]] = []
        for a, b, c in triangles:
            ab, bc, ca = middle(a, b), middle(b, c), middle(c, a)
            finer += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        triangles = finer
    return np.array(vertices), np.array(triangles)
