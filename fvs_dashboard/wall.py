"""The pictures of cameras of which nothing is known, in the place of the 3-D view, to click in."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import viser

from fvs_dashboard.picture import VIEW_PX, Picture, blank

#: Width of a picture in the view, and what is between two.
_WIDTH, _GAP = 1.0, 0.04
#: From a picture's frame, x to the right, y down, to the view's, z up.
_UPRIGHT = (0.5**0.5, -(0.5**0.5), 0.0, 0.0)


class Wall:
    """A picture for each camera, one below the other.

    ``on_click`` gets the camera's number and the point, px in the camera's image, of a click.
    """

    def __init__(
        self, server: viser.ViserServer, count: int, on_click: Callable[[int, np.ndarray], None]
    ) -> None:
        self._on_click, self._empty = on_click, set(range(count))
        self._sizes_px = np.tile([4.0, 3.0], (count, 1))
        look = {"render_width": _WIDTH, "render_height": 0.75 * _WIDTH, "wxyz": _UPRIGHT}
        self._images = [
            server.scene.add_image(f"/picture/{i}", blank(VIEW_PX), format="jpeg", **look)
            for i in range(count)
        ]
        self._arrange()
        for camera in range(count):
            self._listen(camera)

        @server.on_client_connect
        async def _(client: viser.ClientHandle) -> None:
            aspect = 0.0

            @client.camera.on_update
            async def _(look: viser.CameraHandle) -> None:
                """Show all, from the top, whenever the view has another shape."""
                nonlocal aspect
                if look.aspect != aspect:
                    aspect = look.aspect
                    height = max((_WIDTH + 2.0 * _GAP) / aspect, 2.0 * _GAP - self._end)
                    middle = _GAP - 0.5 * height
                    look.position = (0.0, -0.5 * height / np.tan(0.5 * look.fov), middle)
                    look.look_at = (0.0, 0.0, middle)

    def _arrange(self) -> None:
        """Put them below each other."""
        self._end = 0.0
        for image, (width, height) in zip(self._images, self._sizes_px, strict=True):
            image.render_height = _WIDTH * float(height / width)
            image.position = (0.0, 0.0, self._end - 0.5 * image.render_height)
            self._end -= image.render_height + _GAP

    def _listen(self, camera: int) -> None:
        image = self._images[camera]

        @image.on_click
        async def _(event: viser.SceneNodePointerEvent) -> None:
            if camera in self._empty:
                return
            origin, ray = np.array(event.ray_origin), np.array(event.ray_direction)
            # All are in the plane y = 0.
            at = (origin - origin[1] / ray[1] * ray - image.position)[[0, 2]]
            share = 0.5 + (1.0, -1.0) * at / (_WIDTH, image.render_height)
            size_px = self._sizes_px[camera]
            self._on_click(camera, np.clip(share * size_px - 0.5, 0.0, size_px - 1.0))

    def update(self, camera: int, picture: Picture, image: np.ndarray | None) -> None:
        """Show a camera's picture, if there is a new one."""
        if image is None:
            return
        self._empty.discard(camera)
        if np.any(picture.size_px != self._sizes_px[camera]):
            self._sizes_px[camera] = picture.size_px
            self._arrange()
        self._images[camera].image = image
