"""Bytes become pixels as their header says, or one sentence says why not."""

import struct

import cv2
import numpy as np
import pytest
from cases import each
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


PICTURE = np.full((24, 32, 3), (200, 60, 10), np.uint8)
PICTURE[:, 16:] = (20, 60, 210)
#: Columns that a jpeg's coarse colours do not blur.
PLAIN = np.r_[:12, 20:32]


@each("extension", [".png", ".jpg"])
@each(
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
    encoding = data.draw(st.sampled_from(["rgb8", "bgra8", "16UC1", "32FC1", "mono16", "x", *SENT]))
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
