"""Camera images -> numpy.

Nothing here trusts its input: a wrong size or an unknown encoding is a :class:`MessageError` with
words, and sizes are checked before memory is taken.
"""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from sensor_msgs.msg import Image

from fvs_ros.ros.messages import MessageError
from fvs_ros.vectors import LARGEST

#: Unit of whole-number depth, m, by REP 118.
_DEPTH_UNIT_M = np.float32(1e-3)
#: Largest side and number of pixels of an image that is decoded.
_MOST_SIDE_PX, _MOST_PIXELS = 8192, 16_000_000

#: Encodings of ``sensor_msgs``: numbers of a pixel, and their conversion. OpenCV's own images have
#: blue first.
_TO_RGB: dict[str, tuple[int, int | None]] = {
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB),
    "8UC1": (1, cv2.COLOR_GRAY2RGB),
    "8UC3": (3, cv2.COLOR_BGR2RGB),
    "8UC4": (4, cv2.COLOR_BGRA2RGB),
    "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUYV),
    "yuyv": (2, cv2.COLOR_YUV2RGB_YUYV),
    "nv12": (1, cv2.COLOR_YUV2RGB_NV12),
    "nv21": (1, cv2.COLOR_YUV2RGB_NV21),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2RGB),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2RGB),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2RGB),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2RGB),
}
#: The same of 16 bits a number.
_TO_RGB |= {
    f"{name.removesuffix('8')}16": form for name, form in _TO_RGB.items() if name.endswith("8")
}
_DEPTH_TYPES = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}


def from_color(message: Image) -> np.ndarray:
    """Colours of an image, uint8, shape (H, W, 3), red first; they may share its memory.

    It has any encoding of ``sensor_msgs`` for colours, grey, Bayer patterns and YUV, of 16 bits the
    highest 8.
    """
    encoding, width, height = message.encoding, message.width, message.height
    _check_encoding(encoding, _TO_RGB)
    channels, conversion = _TO_RGB[encoding]
    rows = height * 3 // 2 if encoding.startswith("nv") else height
    pixels = _rows(message, "u2" if encoding.endswith("16") else "u1", channels, rows)
    if pixels.dtype == np.uint16:
        if pixels.max() < 2**12:  # 16 grey levels would remain
            raise MessageError(
                f"{encoding} image leaves the highest 4 of 16 bits empty: uncover the lens, or set "
                "the camera to 8 bits"
            )
        pixels = (pixels >> 8).astype(np.uint8)
    pixels = pixels.reshape(rows, width, channels)
    if conversion is None:
        return pixels
    try:
        return cv2.cvtColor(pixels, conversion)
    except cv2.error:
        raise MessageError(f"image of {width}x{height} pixels cannot be {encoding}") from None


def from_depth(message: Image) -> np.ndarray:
    """Depth of an image, m, float32, shape (H, W); 0 where there is none.

    It is ``16UC1`` or ``mono16``, in mm with 0 for none, or ``32FC1``, in m with NaN for none.
    """
    _check_encoding(message.encoding, _DEPTH_TYPES)
    depth = _rows(message, _DEPTH_TYPES[message.encoding], 1, message.height)
    if depth.dtype.kind == "u":
        return np.multiply(depth, _DEPTH_UNIT_M, dtype=np.float32)
    metres = depth.astype(np.float32)
    # Written so that NaN, too, is out.
    metres[~((metres > 0.0) & (metres < LARGEST))] = 0.0
    return metres


def _check_encoding(encoding: str, known: Iterable[str]) -> None:
    if encoding not in known:
        names = ", ".join(known)[:120]
        raise MessageError(f"image encoding {encoding[:40]!r} is not known; expected {names}")


def _rows(message: Image, kind: str, channels: int, height: int) -> np.ndarray:
    """Rows of numbers of a kind without their padding, shape (height, width * channels)."""
    width, step, number = message.width, message.step, np.dtype(kind)
    if width < 1 or height < 1:
        raise MessageError(f"image has no pixels: {width}x{height}")
    if max(width, height) > _MOST_SIDE_PX or width * height > _MOST_PIXELS:
        raise MessageError(
            f"image of {width}x{height} pixels is too large; the limit is {_MOST_PIXELS // 10**6} "
            f"million pixels and {_MOST_SIDE_PX} a side"
        )
    row_bytes = width * channels * number.itemsize
    raw = np.frombuffer(message.data, np.uint8)
    if step < row_bytes:
        raise MessageError(
            f"image rows have {step} bytes, too few for {width} pixels of "
            f"{channels * number.itemsize} bytes"
        )
    # Some drivers leave out the padding of the last row.
    if len(raw) not in (step * height, step * (height - 1) + row_bytes):
        raise MessageError(
            f"image of {height} rows of {step} bytes has {len(raw)} bytes, expected {step * height}"
        )
    rows = np.lib.stride_tricks.as_strided(raw, (height, row_bytes), (step, 1), writeable=False)
    numbers = np.ascontiguousarray(rows).view((">" if message.is_bigendian else "<") + kind)
    return numbers.astype(number, copy=False)
