"""Bytes become pixels as their header says, or one sentence says why not."""

import struct

import numpy as np
import pytest
from cases import each
from hypothesis import given, settings
from hypothesis import strategies as st
from sensor_msgs.msg import Image

from fvs_ros.ros import MessageError
from fvs_ros.ros.images import from_color, from_depth

RGB = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
MILLIMETRES = np.array([[0, 1, 256], [1000, 4660, 65535]], dtype=np.uint16)


def image(data, width, height, step, encoding, big_endian=False):
    size = {"width": width, "height": height, "step": step}
    return Image(data=data, encoding=encoding, is_bigendian=int(big_endian), **size)


@each("order", ["<", ">"])
def test_depth_comes_out_in_metres_and_what_is_none_is_zero(order):
    for encoding in ("16UC1", "mono16"):
        rows = b"".join(row.astype(f"{order}u2").tobytes() + b"\xee\xee" for row in MILLIMETRES)
        depth = from_depth(image(rows, 3, 2, 8, encoding, order == ">"))
        np.testing.assert_allclose(depth, 1e-3 * MILLIMETRES, rtol=1e-6)
    data = struct.pack(f"{order}8f", 0.5, 1.25, np.nan, np.inf, -np.inf, -1.0, 0.0, 1e30)
    depth = from_depth(image(data, 4, 2, 16, "32FC1", order == ">"))
    assert depth.dtype == np.float32
    assert depth.ravel().tolist() == [0.5, 1.25, 0, 0, 0, 0, 0, 0]


@each(
    ("decode", "width", "height", "step", "encoding", "words"),
    [
        (from_color, 3, 2, 9, "nv24", "rgb8, bgr8"),
        (from_color, 3, 3, 6, "yuv422", "cannot be yuv422"),
        (from_depth, 3, 2, 9, "x" * 10_000, "16UC1, mono16, 32FC1"),
        (from_color, 3, 2, 8, "rgb8", "too few"),
        (from_color, 3, 3, 9, "rgb8", "expected 27"),
        (from_color, 2**32 - 1, 2**32 - 1, 2**32 - 1, "rgb8", "too large"),
    ],
)
def test_a_head_that_does_not_fit_is_refused_in_short(decode, width, height, step, encoding, words):
    with pytest.raises(MessageError, match=words) as refusal:
        decode(image(RGB.tobytes(), width, height, step, encoding))
    assert len(str(refusal.value)) < 200


#: A colour, and its luminance and chrominances by BT.601.
COLOUR, (Y, U, V) = (200, 100, 50), (123, 91, 175)
RED, GREEN, BLUE = COLOUR
#: Rows of 4 pixels as a camera sends them, all of this colour or of a grey.
SENT = {
    "rgb8": [[RED, GREEN, BLUE] * 4] * 2,
    "bgr8": [[BLUE, GREEN, RED] * 4] * 2,
    "rgba8": [[RED, GREEN, BLUE, 9] * 4] * 2,
    "bgra8": [[BLUE, GREEN, RED, 9] * 4] * 2,
    "mono8": [[90] * 4] * 2,
    "8UC1": [[90] * 4] * 2,
    "8UC3": [[BLUE, GREEN, RED] * 4] * 2,
    "8UC4": [[BLUE, GREEN, RED, 255] * 4] * 2,
    "yuv422": [[U, Y, V, Y] * 2] * 2,
    "uyvy": [[U, Y, V, Y] * 2] * 2,
    "yuv422_yuy2": [[Y, U, Y, V] * 2] * 2,
    "yuyv": [[Y, U, Y, V] * 2] * 2,
    "nv12": [[Y] * 4, [Y] * 4, [U, V] * 2],
    "nv21": [[Y] * 4, [Y] * 4, [V, U] * 2],
    "bayer_rggb8": [[RED, GREEN] * 2, [GREEN, BLUE] * 2] * 2,
    "bayer_bggr8": [[BLUE, GREEN] * 2, [GREEN, RED] * 2] * 2,
    "bayer_gbrg8": [[GREEN, BLUE] * 2, [RED, GREEN] * 2] * 2,
    "bayer_grbg8": [[GREEN, RED] * 2, [BLUE, GREEN] * 2] * 2,
}


@each("encoding", SENT)
def test_what_cameras_send_comes_out_red_first(encoding):
    rows = np.array(SENT[encoding], np.uint8)
    expected = COLOUR if encoding not in ("mono8", "8UC1") else (90, 90, 90)
    height = 2 if "nv" in encoding else len(rows)
    for padding, cut in ((0, 0), (3, 0), (3, 3)):  # some drivers do not pad the last row
        sent = np.pad(rows, ((0, 0), (0, padding)))
        data = sent.tobytes()[: sent.size - cut]
        decoded = from_color(image(data, 4, height, sent.shape[1], encoding))
        assert decoded.shape == (height, 4, 3)
        assert np.abs(decoded.astype(int) - expected).max() <= 3


def test_16_bits_have_one_scale_in_all_images_and_too_few_are_refused():
    for brightest in (5000, 60000):
        grey = np.array([[2560, brightest]], np.uint16)
        assert from_color(image(grey.tobytes(), 2, 1, 4, "mono16"))[0, 0, 0] == 10
    grey = np.array([[2560, 4095]], np.uint16)
    with pytest.raises(MessageError, match="set the camera to 8 bits"):
        from_color(image(grey.tobytes(), 2, 1, 4, "mono16"))


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
    encoding = data.draw(st.sampled_from(["rgb8", "bgra8", "16UC1", "32FC1", "mono16", "x", *SENT]))
    message = image(raw[:length], width, height, step, encoding, data.draw(st.booleans()))
    for pixels in decoded(message):
        assert pixels.shape[:2] == (height, width)
        assert np.isfinite(pixels).all()
        assert (pixels >= 0).all()
