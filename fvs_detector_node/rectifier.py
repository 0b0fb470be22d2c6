"""Images of a camera with distortion -> those of a pinhole camera."""

from __future__ import annotations

import cv2
import numpy as np

from fvs_detector_node.region import Region
from fvs_ros.camera import CameraModel


class Rectifier:
    """Takes the distortion out of images, or of parts of them.

    The intrinsics stay, so that a pixel near the principal point stays where it is.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    """

    def __init__(self, camera: CameraModel) -> None:
        self.camera = camera
        self._maps: tuple[tuple[np.ndarray, np.ndarray], np.ndarray] | None = None
        if not camera.distorts:
            return
        view = camera.intrinsics
        matrix = np.array([[view.fx, 0.0, view.cx], [0.0, view.fy, view.cy], [0.0, 0.0, 1.0]])
        coefficients = np.array(camera.coefficients)
        make = (
            cv2.fisheye.initUndistortRectifyMap
            if camera.model == "equidistant"
            else cv2.initUndistortRectifyMap
        )
        u, v = make(
            matrix, coefficients, np.eye(3), matrix, (view.width, view.height), cv2.CV_32FC1
        )
        # Nearest neighbours need maps of their own: the others' whole parts are rounded down.
        self._maps = (
            cv2.convertMaps(u, v, cv2.CV_16SC2),
            cv2.convertMaps(u, v, cv2.CV_16SC2, nninterpolation=True)[0],
        )

    def cut(
        self, rgb: np.ndarray, depth_m: np.ndarray, region: Region
    ) -> tuple[np.ndarray, np.ndarray]:
        """Part of the images without distortion.

        Parameters
        ----------
        rgb : ndarray of uint8, shape (H, W, 3)
            Whole colour image as the camera gave it.
        depth_m : ndarray of float32, shape (H, W)
            Whole depth image.
        region : Region
            The part, in the image without distortion.

        Returns
        -------
        rgb : ndarray of uint8, shape (h, w, 3)
            Interpolated; black where the camera did not see.
        depth_m : ndarray of float32, shape (h, w)
            That of the nearest pixel, as a mean of two surfaces is neither; 0 where none.
        """
        part = region.part
        if self._maps is None:
            return rgb[part], depth_m[part]
        (whole, fraction), nearest = self._maps
        return (
            cv2.remap(rgb, whole[part], fraction[part], cv2.INTER_LINEAR),
            cv2.remap(depth_m, nearest[part], np.empty(0), cv2.INTER_NEAREST),
        )
