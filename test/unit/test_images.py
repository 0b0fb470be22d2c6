"""Bytes become pixels as their header says, or one sentence says why not."""

import struct

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sensor_msgs.msg import CompressedImage, Image

from fvs_ros.ros import MessageError, images
from fvs_ros.ros.images import from_color, from_depth

RGB = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
MILLIMETRES = np.array([[0, 1, 256], [1000, 4660, 65535]], dtype=np.uint16)


def image(data, width, height, step, encoding, big_endian=False):
    size = {"width": width, "height": height, "step": step}
    return Image(data=data, encoding=encoding, is_bigendian=int(big_endian), **size)


def compressed(data, image_format):
    return CompressedImage(data=data, format=image_format)


def file_of(pixels, extension=".png"):
    return cv2.imencode(extension, pixels)[1].tobytes()


def depth_file(values, a=0.0, b=0.0):
    """compressedDepth as image_transport sends it: 12 bytes, then a png of 16 bits."""
    return struct.pack("<iff", 0, a, b) + file_of(values)


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize("encoding", ["rgb8", "bgr8", "rgba8", "bgra8"])
def test_colours_come_out_red_first(encoding, padding):
    pixels = RGB[..., ::-1] if "bgr" in encoding else RGB
    if "a8" in encoding:
        pixels = np.dstack([pixels, np.full((2, 3), 9, np.uint8)])
    data = b"".join(row.tobytes() + b"\xee" * padding for row in pixels)
    # Some drivers leave out the padding of the last row.
    for rows in (data, data[: len(data) - padding]):
        decoded = from_color(image(rows, 3, 2, len(data) // 2, encoding))
        np.testing.assert_array_equal(decoded, RGB)


@pytest.mark.parametrize("order", ["<", ">"])
def test_depth_comes_out_in_metres_and_what_is_none_is_zero(order):
    for encoding in ("16UC1", "mono16"):
        rows = b"".join(row.astype(f"{order}u2").tobytes() + b"\xee\xee" for row in MILLIMETRES)
        depth = from_depth(image(rows, 3, 2, 8, encoding, order == ">"))
        np.testing.assert_allclose(depth, 1e-3 * MILLIMETRES, rtol=1e-6)
    data = struct.pack(f"{order}8f", 0.5, 1.25, np.nan, np.inf, -np.inf, -1.0, 0.0, 1e30)
    depth = from_depth(image(data, 4, 2, 16, "32FC1", order == ">"))
    assert depth.dtype == np.float32
    assert depth.ravel().tolist() == [0.5, 1.25, 0, 0, 0, 0, 0, 0]


@pytest.mark.parametrize(
    ("decode", "width", "height", "step", "encoding", "said"),
    [
        (from_color, 3, 2, 9, "nv24", "rgb8, bgr8"),
        (from_color, 3, 3, 6, "yuv422", "cannot be yuv422"),
        (from_depth, 3, 2, 9, "x" * 10_000, "16UC1, mono16, 32FC1"),
        (from_color, 3, 2, 8, "rgb8", "too few"),
        (from_color, 3, 3, 9, "rgb8", "expected 27"),
        (from_color, 2**32 - 1, 2**32 - 1, 2**32 - 1, "rgb8", "too large"),
    ],
)
def test_a_head_that_does_not_fit_is_refused_in_short(decode, width, height, step, encoding, said):
    with pytest.raises(MessageError, match=said) as refusal:
        decode(image(RGB.tobytes(), width, height, step, encoding))
    assert len(str(refusal.value)) < 200


#: A colour, and its luminance and chrominances by BT.601.
COLOUR, (Y, U, V) = (200, 100, 50), (123, 91, 175)


def sent(encoding):
    """A picture of one colour or grey, 4 pixels wide and 2 or 4 high, as a camera sends it."""
    red, green, blue = COLOUR
    whole = {
        "mono8": [90] * 8,
        "8UC1": [90] * 8,
        "8UC3": [blue, green, red] * 8,
        "8UC4": [blue, green, red, 255] * 8,
        "yuv422": [U, Y, V, Y] * 4,
        "uyvy": [U, Y, V, Y] * 4,
        "yuv422_yuy2": [Y, U, Y, V] * 4,
        "yuyv": [Y, U, Y, V] * 4,
        "nv12": [Y] * 8 + [U, V] * 2,
        "nv21": [Y] * 8 + [V, U] * 2,
    }
    if encoding in whole:
        return np.array(whole[encoding], np.uint8).reshape(3 if "nv" in encoding else 2, -1)
    if encoding.startswith("bayer"):
        ((a, b), (c, d)) = (
            [{"r": red, "g": green, "b": blue}[one] for one in pair]
            for pair in (encoding[6:8], encoding[8:10])
        )
        return np.tile(np.array([[a, b], [c, d]], np.uint8), (2, 2))
    raise KeyError(encoding)


@pytest.mark.parametrize(
    "encoding",
    ["mono8", "8UC1", "8UC3", "8UC4", "yuv422", "uyvy", "yuv422_yuy2", "yuyv", "nv12", "nv21"]
    + [f"bayer_{one}8" for one in ("rggb", "bggr", "gbrg", "grbg")],
)
def test_what_cameras_send_comes_out_red_first(encoding):
    rows = sent(encoding)
    padded = np.pad(rows, ((0, 0), (0, 3)))
    expected = COLOUR if encoding not in ("mono8", "8UC1") else (90, 90, 90)
    for each in (rows, padded):
        height = 2 if "nv" in encoding else len(rows)
        decoded = from_color(image(each.tobytes(), 4, height, each.shape[1], encoding))
        assert decoded.shape == (height, 4, 3)
        assert np.abs(decoded.astype(int) - expected).max() <= 3


PICTURE = np.full((24, 32, 3), (200, 60, 10), np.uint8)
PICTURE[:, 16:] = (20, 60, 210)
#: Columns that a jpeg's coarse colours do not blur.
PLAIN = np.r_[:12, 20:32]


@pytest.mark.parametrize("extension", [".png", ".jpg"])
@pytest.mark.parametrize(
    ("image_format", "exchanged"),
    [("rgb8; x compressed bgr8", False), ("jpeg", False), ("bgr8; x compressed", True)],
)
def test_compressed_colours(extension, image_format, exchanged):
    # OpenCV writes blue first; old publishers exchange and leave out the target format.
    file = file_of(PICTURE if exchanged else PICTURE[..., ::-1], extension)
    decoded = from_color(compressed(file, image_format)).astype(int)
    np.testing.assert_allclose(decoded[:, PLAIN], PICTURE[:, PLAIN], atol=12)


def test_compressed_depth():
    for image_format in ("16UC1; compressedDepth png", "16UC1; compressedDepth", "16UC1"):
        depth = from_depth(compressed(depth_file(MILLIMETRES), image_format))
        np.testing.assert_allclose(depth, 1e-3 * MILLIMETRES, rtol=1e-6)
    # Metres as the publisher codes them: its depth_quantization is 100, its depth_max 10 m.
    a = 100.0 * 101.0
    b = 1.0 - a / 10.0
    coded = np.array([[a / 0.5 + b, a / 9.0 + b, 0.0]]).astype(np.uint16)
    depth = from_depth(compressed(depth_file(coded, a, b), "32FC1; compressedDepth png"))
    np.testing.assert_allclose(depth, [[0.5, 9.0, 0.0]], rtol=2e-3)


def decoded(message):
    """What both decoders make of a message, where they do not refuse it."""
    for decode in (from_color, from_depth):
        try:
            yield decode(message)
        except MessageError:
            continue


@given(st.data(), st.booleans())
@settings(max_examples=60, deadline=None)
def test_whatever_comes_is_an_image_of_its_size_or_an_error(data, fitting):
    sizes = st.integers(0, 40) | st.integers(0, 40 if fitting else 2**32 - 1)
    width, height, step = data.draw(sizes), data.draw(sizes), data.draw(sizes)
    length = step * height if fitting else data.draw(st.integers(0, 5000))
    raw = data.draw(st.binary(min_size=1, max_size=64)) * (length // 64 + 1)
    encoding = data.draw(
        st.sampled_from(
            ["rgb8", "bgra8", "16UC1", "32FC1", "mono16", "nv12", "yuyv", "bayer_rggb8", "x"]
        )
    )
    message = image(raw[:length], width, height, step, encoding, data.draw(st.booleans()))
    for pixels in decoded(message):
        assert pixels.shape[:2] == (height, width)
        assert np.isfinite(pixels).all()
        assert (pixels >= 0).all()


@given(
    st.sampled_from([file_of(PICTURE), file_of(PICTURE, ".jpg"), depth_file(MILLIMETRES)]),
    st.lists(st.tuples(st.integers(0, 400), st.integers(0, 255)), max_size=5),
    st.integers(0, 500),
    st.sampled_from(["png", "rgb8; jpeg compressed bgr8", "16UC1; compressedDepth png", "32FC1"]),
)
@settings(max_examples=60, deadline=None)
def test_a_damaged_file_is_an_image_or_an_error(file, flips, length, image_format):
    damaged = bytearray(file)
    for at, value in flips:
        damaged[at % len(damaged)] = value
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(images, "MAX_PIXELS", 10_000)  # the largest take seconds
        for pixels in decoded(compressed(bytes(damaged[:length]), image_format)):
            assert pixels.size <= 3 * 10_000
            assert np.isfinite(pixels).all()
