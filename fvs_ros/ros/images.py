"""Bytes of camera images -> numpy: raw, jpeg, png, and image_transport's compressedDepth.

Nothing here trusts its input: a wrong size, an encoding that is not known or data that does not
decode is an :class:`ImageError` with words, and sizes are checked before memory is taken.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

import cv2
import numpy as np
from sensor_msgs.msg import CompressedImage, Image

from fvs_ros.ros.messages import MessageError

#: Depth beyond this, or not finite, is no depth, m.
MAX_DEPTH_M = 100.0
#: Largest side and number of pixels of an image that is decoded.
MAX_SIDE_PX, MAX_PIXELS = 8192, 16_000_000

_TO_RGB: Mapping[str, tuple[int, int | None]] = {
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
}
_DEPTH_TYPES: Mapping[str, str] = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
#: Some encodings have the right size but do not say which colour comes first.
_NO_COLOUR_ORDER = ("8UC3", "8UC4")
#: compressedDepth begins with an int32 and the two float32 parameters of the inverse depth.
_DEPTH_HEADER = struct.Struct("<iff")
_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"


class ImageError(ValueError):
    """An image that cannot be used; the text says what was wrong and what was expected."""


def decode_colour(data: object, width: int, height: int, step: int, encoding: str) -> np.ndarray:
    """Colours of a raw image.

    Parameters
    ----------
    data : bytes-like
        The pixels, row after row.
    width, height : int
        Size, pixels.
    step : int
        Bytes from one row to the next; rows may be padded.
    encoding : str
        ``rgb8``, ``bgr8``, ``rgba8`` or ``bgra8``.

    Returns
    -------
    ndarray of uint8, shape (height, width, 3)
        Red first. It may share the memory of ``data``.

    Raises
    ------
    ImageError
        If the encoding is another one, or sizes do not agree.
    """
    if encoding in _NO_COLOUR_ORDER:
        raise ImageError(
            f"encoding {encoding} does not say whether red or blue comes first; let the camera "
            f"publish one of {', '.join(_TO_RGB)}"
        )
    if encoding not in _TO_RGB:
        raise ImageError(
            f"colour encoding {encoding[:40]!r} is not known; expected one of {', '.join(_TO_RGB)}"
        )
    channels, conversion = _TO_RGB[encoding]
    rows = _rows(data, width, height, step, channels)
    pixels = rows.reshape(height, width, channels)
    return pixels if conversion is None else cv2.cvtColor(pixels, conversion)


def decode_depth(
    data: object,
    width: int,
    height: int,
    step: int,
    encoding: str,
    *,
    big_endian: bool = False,
    unit_m: float = 0.001,
) -> np.ndarray:
    """Depth of a raw image.

    Parameters
    ----------
    data : bytes-like
        The pixels, row after row.
    width, height : int
        Size, pixels.
    step : int
        Bytes from one row to the next; rows may be padded.
    encoding : str
        ``16UC1`` or ``mono16``, in units of ``unit_m`` with 0 for none, or ``32FC1``, in metres
        with NaN for none.
    big_endian : bool
        Order of the bytes of a pixel.
    unit_m : float
        Unit of whole-number depth, m.

    Returns
    -------
    ndarray of float32, shape (height, width)
        Depth, m; 0 where there is none.

    Raises
    ------
    ImageError
        If the encoding is another one, or sizes do not agree.
    """
    if encoding not in _DEPTH_TYPES:
        raise ImageError(
            f"depth encoding {encoding[:40]!r} is not known; expected one of "
            f"{', '.join(_DEPTH_TYPES)}"
        )
    kind = np.dtype((">" if big_endian else "<") + _DEPTH_TYPES[encoding])
    rows = _rows(data, width, height, step, kind.itemsize)
    depth = rows.view(kind).reshape(height, width)
    return _metres(depth, unit_m if kind.kind == "u" else 1.0)


def decode_compressed_colour(data: object, image_format: str) -> np.ndarray:
    """Colours of a jpeg or png image, as image_transport's ``compressed`` sends it.

    Parameters
    ----------
    data : bytes-like
        The file.
    image_format : str
        ``jpeg``, ``png``, or ``ENCODING; jpeg compressed bgr8``. Without the last word after an
        encoding, red and blue were exchanged before the compression.

    Returns
    -------
    ndarray of uint8, shape (height, width, 3)
        Red first.

    Raises
    ------
    ImageError
        If it is neither jpeg nor png, does not decode, or is too large.
    """
    pixels = _decode_file(data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    encoding, separator, rest = image_format.partition(";")
    if separator and encoding.strip() not in (*_TO_RGB, "mono8"):
        raise ImageError(
            f"compressed colour of encoding {encoding[:40]!r} is not known; expected one of "
            f"{', '.join(_TO_RGB)}"
        )
    exchanged = bool(separator) and "compressed bgr" not in rest
    return pixels if exchanged else cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)


def decode_compressed_depth(data: object, image_format: str, unit_m: float = 0.001) -> np.ndarray:
    """Depth of an image_transport ``compressedDepth`` image.

    A header of 12 bytes (an int32 that does not matter, and two float32 A and B), then a png of
    16 bits. For ``16UC1`` the values are the depth; for ``32FC1`` a value v > 0 stands for the
    depth A / (v - B), m, and 0 for none.

    Parameters
    ----------
    data : bytes-like
        Header and png.
    image_format : str
        ``16UC1; compressedDepth png`` or ``32FC1; compressedDepth png``; older publishers leave
        out the last word, or all but the encoding.
    unit_m : float
        Unit of whole-number depth, m.

    Returns
    -------
    ndarray of float32, shape (height, width)
        Depth, m; 0 where there is none.

    Raises
    ------
    ImageError
        If the format is another one, the data does not decode, or is too large.
    """
    encoding, _, rest = (part.strip() for part in image_format.partition(";"))
    if encoding not in _DEPTH_TYPES:
        raise ImageError(
            f"compressed depth of format {image_format[:60]!r} is not known; expected "
            "'16UC1; compressedDepth png' or '32FC1; compressedDepth png'"
        )
    if rest not in ("", "compressedDepth", "compressedDepth png"):
        raise ImageError(
            f"compressed depth of format {image_format[:60]!r} is not supported; set the "
            "publisher's compressedDepth format to png"
        )
    raw = _bytes(data)
    if len(raw) <= _DEPTH_HEADER.size:
        raise ImageError(f"compressed depth has {len(raw)} bytes, too few for header and image")
    _, scale, offset = _DEPTH_HEADER.unpack(raw[: _DEPTH_HEADER.size].tobytes())
    pixels = _decode_file(raw[_DEPTH_HEADER.size :], cv2.IMREAD_UNCHANGED)
    if pixels.dtype != np.uint16 or pixels.ndim != 2:
        raise ImageError(
            f"compressed depth holds an image of {pixels.dtype} with shape {pixels.shape}, "
            "expected one channel of 16 bits (is it the topic ending in /compressedDepth?)"
        )
    if encoding != "32FC1":
        return _metres(pixels, unit_m)
    if not (np.isfinite(scale) and np.isfinite(offset) and scale > 0.0):
        raise ImageError(f"compressed depth has inverse-depth parameters {scale:g} and {offset:g}")
    with np.errstate(divide="ignore", over="ignore"):
        depth = np.float32(scale) / (pixels.astype(np.float32) - np.float32(offset))
    depth[pixels == 0] = 0.0
    return _metres(depth, 1.0)


def _metres(depth: np.ndarray, unit_m: float) -> np.ndarray:
    """Depth, float32, m, 0 where there is none or none that can be."""
    if depth.dtype.kind == "u":
        metres = np.multiply(depth, np.float32(unit_m), dtype=np.float32)
        if 65535.0 * unit_m < MAX_DEPTH_M:
            return metres
    else:
        metres = depth.astype(np.float32)
    # Written so that NaN, too, is out.
    metres[~((metres > 0.0) & (metres < MAX_DEPTH_M))] = 0.0
    return metres


def _bytes(data: object) -> np.ndarray:
    return np.frombuffer(data, dtype=np.uint8)  # type: ignore[call-overload]


def _rows(data: object, width: int, height: int, step: int, pixel_bytes: int) -> np.ndarray:
    """Rows of pixels without their padding, uint8, contiguous, shape (height, bytes)."""
    _check_size(width, height)
    row_bytes = width * pixel_bytes
    raw = _bytes(data)
    if step < row_bytes:
        raise ImageError(
            f"image rows have {step} bytes, too few for {width} pixels of {pixel_bytes} bytes"
        )
    if len(raw) != step * height and len(raw) != step * (height - 1) + row_bytes:
        raise ImageError(
            f"image of {height} rows of {step} bytes has {len(raw)} bytes, expected {step * height}"
        )
    if step == row_bytes:
        return raw.reshape(height, row_bytes)
    rows = np.lib.stride_tricks.as_strided(raw, (height, row_bytes), (step, 1), writeable=False)
    return np.ascontiguousarray(rows)


def _check_size(width: int, height: int) -> None:
    if width < 1 or height < 1:
        raise ImageError(f"image has no pixels: {width}x{height}")
    if max(width, height) > MAX_SIDE_PX or width * height > MAX_PIXELS:
        raise ImageError(
            f"image of {width}x{height} pixels is too large; the limit is {MAX_PIXELS // 10**6} "
            f"million pixels and {MAX_SIDE_PX} a side"
        )


def _decode_file(data: object, flags: int) -> np.ndarray:
    """Decode a jpeg or png, its size checked before memory is taken for it."""
    raw = _bytes(data)
    _check_size(*_file_size(raw))
    try:
        pixels = cv2.imdecode(raw, flags)
    except cv2.error as error:
        raise ImageError(f"image does not decode: {str(error).splitlines()[0][:100]}") from error
    if pixels is None:
        raise ImageError(f"image of {len(raw)} bytes does not decode; it is damaged or cut off")
    return pixels


def _file_size(raw: np.ndarray) -> tuple[int, int]:
    """Width and height that the head of a png or jpeg file names."""
    head = raw[:32].tobytes()
    if head.startswith(_PNG):
        if len(head) < 24:
            raise ImageError("png image is cut off in its head")
        width, height = struct.unpack(">II", head[16:24])
        return width, height
    if not head.startswith(_JPEG):
        raise ImageError("compressed image is neither jpeg nor png")
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
    raise ImageError("jpeg image is cut off in its head")


def from_color(message: Image | CompressedImage) -> np.ndarray:
    """Colours of an image, red first, uint8, shape (H, W, 3).

    Raises
    ------
    MessageError
        If it cannot be decoded.
    """
    try:
        if isinstance(message, CompressedImage):
            return decode_compressed_colour(message.data, message.format)
        return decode_colour(
            message.data, message.width, message.height, message.step, message.encoding
        )
    except ImageError as error:
        raise MessageError(str(error)) from error


def from_depth(message: Image | CompressedImage, unit_m: float) -> np.ndarray:
    """Depth of an image, m, 0 where there is none, float32, shape (H, W).

    Parameters
    ----------
    message : Image or CompressedImage
        16UC1 or 32FC1, raw or as ``compressedDepth``.
    unit_m : float
        Unit of whole-number depth, m.

    Raises
    ------
    MessageError
        If it cannot be decoded.
    """
    try:
        if isinstance(message, CompressedImage):
            return decode_compressed_depth(message.data, message.format, unit_m)
        return decode_depth(
            message.data,
            message.width,
            message.height,
            message.step,
            message.encoding,
            big_endian=bool(message.is_bigendian),
            unit_m=unit_m,
        )
    except ImageError as error:
        raise MessageError(str(error)) from error
