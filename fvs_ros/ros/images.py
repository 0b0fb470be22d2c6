"""Camera images -> numpy: raw, jpeg, png, and image_transport's compressedDepth.

Nothing here trusts its input: a wrong size, an unknown encoding or data that does not decode is a
:class:`MessageError` with words, and sizes are checked before memory is taken.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable

import cv2
import numpy as np
from sensor_msgs.msg import CompressedImage, Image

from fvs_ros.ros.messages import MessageError
from fvs_ros.vectors import LARGEST

#: Unit of whole-number depth, m, by REP 118.
_DEPTH_UNIT_M = np.float32(1e-3)
#: Largest side and number of pixels of an image that is decoded.
MAX_SIDE_PX, MAX_PIXELS = 8192, 16_000_000

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
#: compressedDepth begins with an int32 and the two float32 parameters of the inverse depth.
_DEPTH_HEADER = struct.Struct("<iff")
_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"


def from_color(message: Image | CompressedImage) -> np.ndarray:
    """Colours of an image, uint8, shape (H, W, 3), red first; they may share its memory.

    It has any encoding of ``sensor_msgs`` for colours, grey, Bayer patterns and YUV, of 16 bits the
    highest 8; or is jpeg or png, of the format ``jpeg``, ``png`` or ``ENCODING; jpeg compressed
    bgr8``. Without the last word after an encoding, red and blue were exchanged before the
    compression.
    """
    if isinstance(message, CompressedImage):
        encoding, separator, rest = message.format.partition(";")
        if separator:
            _check_encoding(encoding.strip(), _TO_RGB)
        pixels = _decode_file(message.data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        exchanged = bool(separator) and "compressed bgr" not in rest
        return pixels if exchanged else cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)
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


def from_depth(message: Image | CompressedImage) -> np.ndarray:
    """Depth of an image, m, float32, shape (H, W); 0 where there is none.

    It is ``16UC1`` or ``mono16``, in mm with 0 for none, or ``32FC1``, in m with NaN for none; or
    these as ``ENCODING; compressedDepth png``.
    """
    if isinstance(message, CompressedImage):
        depth = _decode_depth_file(message)
    else:
        _check_encoding(message.encoding, _DEPTH_TYPES)
        depth = _rows(message, _DEPTH_TYPES[message.encoding], 1, message.height)
    if depth.dtype.kind == "u":
        return np.multiply(depth, _DEPTH_UNIT_M, dtype=np.float32)
    metres = depth.astype(np.float32)
    # Written so that NaN, too, is out.
    metres[~((metres > 0.0) & (metres < LARGEST))] = 0.0
    return metres


def _decode_depth_file(message: CompressedImage) -> np.ndarray:
    """Decode a header of 12 bytes, an int32 and two float32 A and B, and a png of 16 bits.

    For ``32FC1`` a value v > 0 stands for the depth A / (v - B), m; other values are the depth.
    """
    encoding, _, rest = (part.strip() for part in message.format.partition(";"))
    _check_encoding(encoding, _DEPTH_TYPES)
    # Older publishers leave out the last word, or all but the encoding.
    if rest not in ("", "compressedDepth", "compressedDepth png"):
        raise MessageError(
            f"compressed depth of format {message.format[:60]!r} is not supported; set the "
            "publisher's compressedDepth format to png"
        )
    raw = np.frombuffer(message.data, np.uint8)
    if len(raw) <= _DEPTH_HEADER.size:
        raise MessageError(f"compressed depth has {len(raw)} bytes, too few for header and image")
    _, scale, offset = _DEPTH_HEADER.unpack(raw[: _DEPTH_HEADER.size].tobytes())
    pixels = _decode_file(raw[_DEPTH_HEADER.size :], cv2.IMREAD_UNCHANGED)
    if pixels.dtype != np.uint16 or pixels.ndim != 2:
        raise MessageError(
            f"compressed depth holds an image of {pixels.dtype} with shape {pixels.shape}, "
            "expected one channel of 16 bits (is it the topic ending in /compressedDepth?)"
        )
    if _DEPTH_TYPES[encoding] == "u2":
        return pixels
    if not (np.isfinite(scale) and np.isfinite(offset) and scale > 0.0):
        raise MessageError(
            f"compressed depth has inverse-depth parameters {scale:g} and {offset:g}"
        )
    with np.errstate(divide="ignore", over="ignore"):
        depth = np.float32(scale) / (pixels.astype(np.float32) - np.float32(offset))
    depth[pixels == 0] = 0.0
    return depth


def _check_encoding(encoding: str, known: Iterable[str]) -> None:
    if encoding not in known:
        raise MessageError(
            f"image encoding {encoding[:40]!r} is not known; expected one of "
            f"{', '.join(known)[:120]}"
        )


def _rows(message: Image, kind: str, channels: int, height: int) -> np.ndarray:
    """Rows of numbers of a kind without their padding, shape (height, width * channels)."""
    width, step, number = message.width, message.step, np.dtype(kind)
    _check_size(width, height)
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


def _check_size(width: int, height: int) -> None:
    if width < 1 or height < 1:
        raise MessageError(f"image has no pixels: {width}x{height}")
    if max(width, height) > MAX_SIDE_PX or width * height > MAX_PIXELS:
        raise MessageError(
            f"image of {width}x{height} pixels is too large; the limit is {MAX_PIXELS // 10**6} "
            f"million pixels and {MAX_SIDE_PX} a side"
        )


def _decode_file(data: object, flags: int) -> np.ndarray:
    """Decode a jpeg or png, its size checked before memory is taken for it."""
    raw = np.frombuffer(data, np.uint8)  # type: ignore[call-overload]
    _check_size(*_file_size(raw))
    try:
        pixels = cv2.imdecode(raw, flags)
    except cv2.error:
        pixels = None
    if pixels is None:
        raise MessageError(f"image of {len(raw)} bytes does not decode; it is damaged or cut off")
    return pixels


def _file_size(raw: np.ndarray) -> tuple[int, int]:
    """Width and height that the head of a png or jpeg file names."""
    head = raw[:24].tobytes()
    if head.startswith(_PNG) and len(head) == 24:
        width, height = struct.unpack(">II", head[16:])
        return width, height
    if not head.startswith((_PNG, _JPEG)):
        raise MessageError("compressed image is neither jpeg nor png")
    at = 2
    while at + 9 <= len(raw) and raw[at] == 0xFF:
        marker = int(raw[at + 1])
        if marker == 0xFF:  # filling
            at += 1
            continue
        # Start of frame, of any kind; C4, C8 and CC are something else.
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", raw[at + 5 : at + 9].tobytes())
            return width, height
        length = int(raw[at + 2]) * 256 + int(raw[at + 3])
        at += 2 + max(length, 2)
    raise MessageError("compressed image is cut off in its head")
