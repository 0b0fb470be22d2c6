"""Bytes become pixels as their header says, or one sentence says why not."""

import struct

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fvs_ros.ros.images import (
    MAX_PIXELS,
    ImageError,
    decode_colour,
    decode_compressed_colour,
    decode_compressed_depth,
    decode_depth,
)

RGB = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
MILLIMETRES = np.array([[0, 1, 256], [1000, 4660, 65535]], dtype=np.uint16)


def file_of(pixels, extension=".png", *options):
    return cv2.imencode(extension, pixels, list(options))[1].tobytes()


# ------------------------------------------------------------------------------- raw colour
@pytest.mark.parametrize(
    ("encoding", "pixels"),
    [
        ("rgb8", RGB),
        ("bgr8", RGB[..., ::-1]),
        ("rgba8", np.dstack([RGB, np.full((2, 3), 9, np.uint8)])),
        ("bgra8", np.dstack([RGB[..., ::-1], np.full((2, 3), 9, np.uint8)])),
    ],
)
@pytest.mark.parametrize("padding", [0, 5])
def test_colours_come_out_red_first(encoding, pixels, padding):
    rows = [row.tobytes() + b"\xee" * padding for row in pixels]
    step = len(rows[0])
    decoded = decode_colour(b"".join(rows), 3, 2, step, encoding)
    np.testing.assert_array_equal(decoded, RGB)
    # Some drivers leave out the padding of the last row.
    last_bare = b"".join(rows)[: step * 2 - padding]
    np.testing.assert_array_equal(decode_colour(last_bare, 3, 2, step, encoding), RGB)


def test_plain_rgb_is_not_copied():
    data = bytearray(RGB.tobytes())
    decoded = decode_colour(data, 3, 2, 9, "rgb8")
    data[0] = 77
    assert decoded[0, 0, 0] == 77


@pytest.mark.parametrize("encoding", ["8UC3", "mono8", "yuv422", "bayer_rggb8", "", "x" * 10_000])
def test_other_colour_encodings_are_refused_with_those_that_are_known(encoding):
    with pytest.raises(ImageError, match="rgb8, bgr8") as refusal:
        decode_colour(RGB.tobytes(), 3, 2, 9, encoding)
    assert len(str(refusal.value)) < 200


@pytest.mark.parametrize(
    ("width", "height", "step", "said"),
    [
        (3, 2, 8, "too few"),
        (3, 3, 9, "expected 27"),
        (3, 1, 9, "expected 9"),
        (0, 2, 9, "no pixels"),
        (3, 0, 9, "no pixels"),
        (2**32 - 1, 2**32 - 1, 2**32 - 1, "too large"),
        (1, 100_000, 3, "too large"),
    ],
)
def test_sizes_that_do_not_agree_are_refused(width, height, step, said):
    with pytest.raises(ImageError, match=said):
        decode_colour(RGB.tobytes(), width, height, step, "rgb8")


# -------------------------------------------------------------------------------- raw depth
@pytest.mark.parametrize("encoding", ["16UC1", "mono16"])
@pytest.mark.parametrize("order", ["little", "big"])
@pytest.mark.parametrize("padding", [0, 3])
def test_millimetres_become_metres(encoding, order, padding):
    rows = [
        b"".join(int(value).to_bytes(2, order) for value in row) + b"\xee" * padding
        for row in MILLIMETRES
    ]
    depth = decode_depth(b"".join(rows), 3, 2, len(rows[0]), encoding, big_endian=order == "big")
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, 1e-3 * MILLIMETRES, rtol=1e-6)


def test_another_unit():
    depth = decode_depth(MILLIMETRES.tobytes(), 3, 2, 6, "16UC1", unit_m=1e-4)
    np.testing.assert_allclose(depth, 1e-4 * MILLIMETRES, rtol=1e-6)


@pytest.mark.parametrize("order", ["<", ">"])
def test_metres_stay_and_what_is_no_depth_is_zero(order):
    values = [0.5, 1.25, np.nan, np.inf, -np.inf, -1.0, 0.0, 1e30]
    data = struct.pack(f"{order}8f", *values)
    depth = decode_depth(data, 4, 2, 16, "32FC1", big_endian=order == ">", unit_m=0.5)
    assert depth.ravel().tolist() == [0.5, 1.25, 0, 0, 0, 0, 0, 0]


def test_other_depth_encodings_are_refused():
    with pytest.raises(ImageError, match="16UC1, mono16, 32FC1"):
        decode_depth(MILLIMETRES.tobytes(), 3, 2, 6, "rgb8")


# ------------------------------------------------------------------------- compressed colour
PICTURE = np.full((24, 32, 3), (200, 60, 10), np.uint8)
PICTURE[:, 16:] = (20, 60, 210)
#: Columns that a jpeg's coarse colours do not blur.
PLAIN = np.r_[:12, 20:32]


@pytest.mark.parametrize("extension", [".png", ".jpg"])
@pytest.mark.parametrize("encoding", ["rgb8", "bgr8", "rgba8"])
def test_compressed_colours(extension, encoding):
    kind = {".png": "png", ".jpg": "jpeg"}[extension]
    right = file_of(PICTURE[..., ::-1], extension)  # OpenCV writes blue first
    for image_format in (f"{encoding}; {kind} compressed bgr8", kind):
        decoded = decode_compressed_colour(right, image_format)
        np.testing.assert_allclose(decoded.astype(int)[:, PLAIN], PICTURE[:, PLAIN], atol=12)
    # Old publishers say so by leaving out the target format.
    exchanged = file_of(PICTURE, extension)
    decoded = decode_compressed_colour(exchanged, f"{encoding}; {kind} compressed")
    np.testing.assert_allclose(decoded.astype(int)[:, PLAIN], PICTURE[:, PLAIN], atol=12)


def claim_size(data, width, height):
    """A png whose head claims another size."""
    return data[:16] + struct.pack(">II", width, height) + data[24:]


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "neither"),
        (b"GIF89a" + b"\0" * 50, "neither"),
        (file_of(PICTURE)[:20], "cut off"),
        (file_of(PICTURE, ".jpg")[:30], "cut off"),
        (file_of(PICTURE)[:60], "does not decode"),
        (claim_size(file_of(PICTURE), 60_000, 60_000), "too large"),
        (claim_size(file_of(PICTURE), 8000, 1 + MAX_PIXELS // 8000), "too large"),
        (claim_size(file_of(PICTURE), 0, 5), "no pixels"),
    ],
)
def test_a_bad_file_is_a_sentence(data, said):
    with pytest.raises(ImageError, match=said):
        decode_compressed_colour(data, "rgb8; png compressed bgr8")


# -------------------------------------------------------------------------- compressed depth
def compressed_depth(values, a=0.0, b=0.0):
    """compressedDepth as image_transport sends it: 12 bytes, then a png of 16 bits."""
    return struct.pack("<iff", 0, a, b) + file_of(values)


@pytest.mark.parametrize(
    "image_format", ["16UC1; compressedDepth png", "16UC1; compressedDepth", "16UC1"]
)
def test_compressed_millimetres(image_format):
    depth = decode_compressed_depth(compressed_depth(MILLIMETRES), image_format)
    np.testing.assert_allclose(depth, 1e-3 * MILLIMETRES, rtol=1e-6)


def test_compressed_metres_are_inverse_depth():
    # What the publisher does, with its default depth_quantization 100 and depth_max 10 m.
    a = 100.0 * 101.0
    b = 1.0 - a / 10.0
    metres = np.array([[0.5, 1.0, 2.0, 9.0]])
    coded = (a / metres + b).astype(np.uint16)
    coded = np.append(coded, [[0]], axis=1).astype(np.uint16)
    depth = decode_compressed_depth(compressed_depth(coded, a, b), "32FC1; compressedDepth png")
    np.testing.assert_allclose(depth[0, :4], metres[0], rtol=2e-3)
    assert depth[0, 4] == 0.0


@pytest.mark.parametrize(
    ("data", "image_format", "said"),
    [
        (compressed_depth(MILLIMETRES), "rgb8; compressedDepth png", "16UC1"),
        (compressed_depth(MILLIMETRES), "16UC1; compressedDepth rvl", "png"),
        (b"\0" * 12, "16UC1; compressedDepth png", "too few"),
        (file_of(MILLIMETRES), "16UC1; compressedDepth png", "neither"),
        (compressed_depth(PICTURE), "16UC1; compressedDepth png", "16 bits"),
        (compressed_depth(MILLIMETRES, np.nan, 0), "32FC1; compressedDepth png", "nan"),
        (compressed_depth(MILLIMETRES)[:60], "16UC1; compressedDepth png", "does not decode"),
    ],
)
def test_bad_compressed_depth_is_a_sentence(data, image_format, said):
    with pytest.raises(ImageError, match=said):
        decode_compressed_depth(data, image_format)


# ------------------------------------------------------------------------------- anything
SIZES = st.integers(0, 40) | st.integers(0, 2**32 - 1)
COLOURS = st.sampled_from(["rgb8", "bgr8", "rgba8", "bgra8"]) | st.text(max_size=10)
DEPTHS = st.sampled_from(["16UC1", "mono16", "32FC1"]) | st.text(max_size=10)


@given(st.data(), st.booleans())
@settings(max_examples=300, deadline=None)
def test_whatever_comes_is_an_image_of_its_size_or_an_error(data, fitting):
    width, height, step = data.draw(SIZES), data.draw(SIZES), data.draw(SIZES)
    if fitting:
        width, height, step = width % 40, height % 40, step % 200
    length = step * height if fitting else data.draw(st.integers(0, 3000))
    raw = data.draw(st.binary(min_size=1, max_size=64)) * (length // 64 + 1)
    try:
        colour = decode_colour(raw[:length], width, height, step, data.draw(COLOURS))
        assert colour.shape == (height, width, 3)
        assert colour.dtype == np.uint8
    except ImageError:
        pass
    try:
        big = data.draw(st.booleans())
        depth = decode_depth(raw[:length], width, height, step, data.draw(DEPTHS), big_endian=big)
        assert depth.shape == (height, width)
        assert np.isfinite(depth).all()
        assert (depth >= 0.0).all()
    except ImageError:
        pass


@given(
    st.sampled_from([file_of(PICTURE), file_of(PICTURE, ".jpg"), compressed_depth(MILLIMETRES)]),
    st.lists(st.tuples(st.integers(0, 400), st.integers(0, 255)), max_size=5),
    st.integers(0, 500),
    st.sampled_from(["png", "rgb8; jpeg compressed bgr8", "16UC1; compressedDepth png", "32FC1"]),
)
@settings(max_examples=300, deadline=None)
def test_a_damaged_file_is_an_image_or_an_error(file, flips, length, image_format):
    damaged = bytearray(file)
    for at, value in flips:
        damaged[at % len(damaged)] = value
    for decode in (decode_compressed_colour, decode_compressed_depth):
        try:
            pixels = decode(bytes(damaged[:length]), image_format)
        except ImageError:
            continue
        assert pixels.size <= 3 * MAX_PIXELS
        assert np.isfinite(pixels).all()
