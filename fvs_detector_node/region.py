"""A part of an image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fvs_ros.camera import Intrinsics


@dataclass(frozen=True)
class Region:
    """A part of an image: first pixel (u0, v0) and size, pixels."""

    u0: int
    v0: int
    width: int
    height: int

    @classmethod
    def whole(cls, camera: Intrinsics) -> Region:
        """All of a camera's image."""
        return cls(0, 0, camera.width, camera.height)

    @property
    def part(self) -> tuple[slice, slice]:
        """Rows and columns of the image."""
        return np.s_[self.v0 : self.v0 + self.height, self.u0 : self.u0 + self.width]

    def view(self, camera: Intrinsics) -> Intrinsics:
        """Intrinsics of this part of a camera's image."""
        return camera.window(self.u0, self.v0, self.width, self.height)

    def grown(self, margin: int, camera: Intrinsics) -> Region:
        """The part with a margin, pixels, as far as a camera's image goes."""
        u0, v0 = max(0, self.u0 - margin), max(0, self.v0 - margin)
        u1 = min(camera.width, self.u0 + self.width + margin)
        v1 = min(camera.height, self.v0 + self.height + margin)
        return Region(u0, v0, u1 - u0, v1 - v0)

    def cuts_off(self, u: float, v: float, radius: float, camera: Intrinsics) -> bool:
        """Whether the part's border, but not the image's, cuts a circle off; all in pixels."""
        return bool(
            (u - radius < self.u0 and self.u0 > 0)
            or (v - radius < self.v0 and self.v0 > 0)
            or (u + radius > self.u0 + self.width < camera.width)
            or (v + radius > self.v0 + self.height < camera.height)
        )
