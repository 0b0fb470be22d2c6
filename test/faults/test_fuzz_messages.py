"""Any message at all: a finite array of the right shape, or the one error that callers expect."""

from __future__ import annotations

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PointStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, String

from fvs_ros import ros
from fvs_ros.joints import UR_JOINT_NAMES, JointMap, JointStateError
from fvs_ros.ros.inputs import unpacked

MANY = settings(max_examples=200, derandomize=True, deadline=None)
NUMBER = st.floats(width=64)
NAME = st.one_of(st.sampled_from([*UR_JOINT_NAMES, "left_elbow_joint", ""]), st.text(max_size=8))
SECONDS, NANOSECONDS = st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1)


def outcome(error, call, *arguments):
    """What the call answers, or None and the words of its refusal."""
    try:
        return call(*arguments), ""
    except error as refusal:
        return None, str(refusal)


def is_vector(value, *shape):
    return value.shape == shape and value.dtype == np.float64 and bool(np.all(np.isfinite(value)))


@MANY
@given(
    names=st.one_of(
        st.lists(NAME, max_size=9),
        st.permutations(UR_JOINT_NAMES),
        st.tuples(st.permutations(UR_JOINT_NAMES), st.lists(NAME, max_size=3)).map(
            lambda parts: [*parts[0], *parts[1]]
        ),
    ),
    data=st.data(),
)
def test_joint_states(names, data):
    sizes = st.one_of(st.just(len(names)), st.integers(0, 10))
    size = data.draw(sizes)
    numbers = st.one_of(st.floats(-7.0, 7.0), NUMBER)
    positions = data.draw(st.lists(numbers, min_size=size, max_size=size))
    message = JointState(name=names, position=positions)
    joint_map = JointMap(UR_JOINT_NAMES, data.draw(st.sampled_from(["", "left_"])))
    for _ in range(2):  # the map remembers the names it saw last
        joints, refusal = outcome(
            JointStateError, joint_map.positions, message.name, message.position
        )
        if joints is None:
            assert refusal
            continue
        assert is_vector(joints, 6)
        assert not set(joints.tolist()) - set(positions)
        assert len(names) == len(positions)


def test_a_joint_named_twice_with_two_positions_is_ambiguous():
    names = [*UR_JOINT_NAMES, UR_JOINT_NAMES[0]]
    with pytest.raises(JointStateError):
        JointMap(UR_JOINT_NAMES).positions(names, [0.0] * 6 + [1.0])


@MANY
@given(
    frame=st.one_of(st.just("camera"), st.text(max_size=8)), point=st.tuples(NUMBER, NUMBER, NUMBER)
)
def test_points(frame, point):
    message = PointStamped()
    message.header.frame_id = frame
    message.point.x, message.point.y, message.point.z = point
    position, refusal = outcome(
        ros.MessageError, ros.from_point, message, "camera", "ball_position"
    )
    good = frame == "camera" and all(map(math.isfinite, point))
    assert (position is not None) == good
    if position is None:
        assert "ball_position" in refusal
        return
    assert is_vector(position, 3)
    assert tuple(position) == point


@MANY
@given(
    sizes=st.one_of(st.sampled_from([[], [3, 6]]), st.lists(st.integers(0, 2**32 - 1), max_size=4)),
    offset=st.integers(0, 2**32 - 1),
    label=st.text(max_size=5),
    data=st.one_of(
        st.lists(NUMBER, max_size=20),
        st.lists(st.floats(-1.0, 1.0), min_size=18, max_size=18),
    ),
)
def test_jacobians(sizes, offset, label, data):
    message = Float64MultiArray(data=data)
    message.layout.dim = [MultiArrayDimension(label=label, size=n, stride=n) for n in sizes]
    message.layout.data_offset = offset
    jacobian, refusal = outcome(ros.MessageError, ros.from_jacobian, message)
    assert is_vector(jacobian, 3, 6) if jacobian is not None else "jacobian" in refusal


@MANY
@given(
    size=st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1)) | st.just((640, 480)),
    k=st.lists(NUMBER, min_size=9, max_size=9)
    | st.just([600.0, 0.0, 320.0, 0.0, 600.0, 240.0, 0.0, 0.0, 1.0]),
    d=st.lists(NUMBER | st.floats(-0.5, 0.5), max_size=15),
    model=st.sampled_from(["", "plumb_bob", "rational_polynomial", "equidistant"])
    | st.text(max_size=5),
    binning=st.tuples(st.integers(0, 3), st.integers(0, 2**32 - 1)) | st.just((0, 0)),
    roi=st.lists(st.integers(0, 2**32 - 1), min_size=4, max_size=4) | st.just([0, 0, 0, 0]),
)
def test_camera_infos(size, k, d, model, binning, roi):
    message = CameraInfo(width=size[0], height=size[1], k=k, d=d, distortion_model=model)
    message.binning_x, message.binning_y = binning
    message.roi.x_offset, message.roi.y_offset, message.roi.width, message.roi.height = roi
    camera, refusal = outcome(ros.MessageError, ros.from_camera_info, message)
    if camera is None:
        assert refusal
        return
    numbers = [v for v in vars(camera.intrinsics).values() if isinstance(v, (int, float))]
    assert all(map(math.isfinite, numbers))
    assert camera.intrinsics.fx > 0.0
    assert camera.intrinsics.fy > 0.0


@MANY
@given(
    pairs=st.lists(st.tuples(st.text(max_size=6), st.text(max_size=6)), max_size=6),
    level=st.binary(min_size=1, max_size=1),
    message=st.text(max_size=10),
)
def test_statuses(pairs, level, message):
    values = [KeyValue(key=key, value=value) for key, value in pairs]
    found = ros.from_status(DiagnosticStatus(level=level, message=message, values=values))
    assert found == dict(pairs)


@MANY
@given(
    values=st.dictionaries(
        st.text(max_size=5),
        st.one_of(NUMBER, st.none(), st.text(max_size=5), st.booleans(), st.integers()),
        max_size=5,
    )
)
def test_any_key_numbers_make_a_status(values):
    status = ros.to_status(ros.OK, "name", "text", values)
    assert list(ros.from_status(status)) == list(values)
    for name, value in values.items():
        if isinstance(value, float) and not math.isfinite(value):
            assert ros.from_status(status)[name] == "unknown"


@MANY
@given(sec=SECONDS, nanosec=st.integers(0, 999_999_999))
def test_a_stamp_survives_the_way_through_seconds(sec, nanosec):
    message = PointStamped()
    message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
    stamp_s = ros.from_stamp(message.header.stamp)
    again = ros.to_stamp(min(stamp_s, 2.0**31 - 1.0))
    assert abs(ros.from_stamp(again) - stamp_s) < 1.0 + 1e-6


def test_a_stamp_of_more_than_a_second_of_nanoseconds_at_the_end_of_time():
    message = PointStamped()
    message.header.stamp.sec, message.header.stamp.nanosec = 2**31 - 1, 2**32 - 1
    ros.to_stamp(ros.from_stamp(message.header.stamp))


@MANY
@given(velocity=arrays.arrays(np.float64, 6, elements=st.floats(-1e308, 1e308)))
def test_a_command_is_what_was_decided(velocity):
    data = ros.to_command(velocity).data
    assert data.typecode == "d"
    assert list(data) == velocity.tolist()


@pytest.mark.parametrize(
    "velocity",
    [
        np.full(6, np.nan),
        np.array([0.0] * 5 + [np.inf]),
        np.zeros(5),
        np.zeros(7),
        np.zeros((2, 3)),
    ],
    ids=["NaN", "inf", "five", "seven", "two rows"],
)
def test_a_command_that_is_not_six_finite_numbers_is_never_made(velocity):
    with pytest.raises(ros.MessageError):
        ros.to_command(velocity)


@MANY
@given(jacobian=arrays.arrays(np.float64, (3, 6), elements=st.floats(-1e9, 1e9)))
def test_a_jacobian_comes_back_as_it_was(jacobian):
    np.testing.assert_array_equal(ros.from_jacobian(ros.to_jacobian(jacobian)), jacobian)


@MANY
@given(vector=st.tuples(NUMBER, NUMBER, NUMBER), stamp_s=st.floats(-1e9, 2e9))
def test_points_and_vectors_are_written_as_they_are(vector, stamp_s):
    point = ros.to_point(stamp_s, "frame", np.array(vector)).point
    arrow = ros.to_vector(stamp_s, "frame", np.array(vector)).vector
    for one in (point, arrow):
        np.testing.assert_array_equal([one.x, one.y, one.z], vector)


def in_frame(kind, frame):
    message = kind()
    message.header.frame_id = frame
    return message


def with_dimensions(count):
    message = Float64MultiArray()
    message.layout.dim = [MultiArrayDimension()] * count
    return message


@pytest.mark.parametrize(
    ("small", "large"),
    [
        (in_frame(PointStamped, "camera"), in_frame(PointStamped, "x" * 10**6)),
        (with_dimensions(2), with_dimensions(10**5)),
        (Float64MultiArray(data=[0.0] * 18), Float64MultiArray(data=[0.0] * 10**5)),
        (JointState(name=["joint"] * 100), JointState(name=["joint"] * 10**4)),
        (DiagnosticStatus(values=[KeyValue()] * 50), DiagnosticStatus(values=[KeyValue()] * 10**4)),
        (String(data="<robot/>" * 10**4), String(data="<robot/>" * 10**6)),
    ],
    ids=["frame_id", "dimensions", "values", "joints", "key numbers", "URDF"],
)
def test_a_message_is_unpacked_unless_it_is_too_large(small, large):
    assert unpacked(type(small), serialize_message(small)) == small
    with pytest.raises(ros.MessageError, match="expected at most"):
        unpacked(type(large), serialize_message(large))


def test_an_image_is_large_but_its_text_is_not():
    image = Image(height=1000, width=1000, step=3000, data=bytes(3 * 10**6))
    assert unpacked(Image, image) is image
    with pytest.raises(ros.MessageError, match="frame_id"):
        unpacked(Image, in_frame(Image, "x" * 10**6))


@MANY
@given(kind=st.sampled_from([JointState, PointStamped, Float64MultiArray]), data=st.binary())
def test_any_bytes_are_a_message_or_refused(kind, data):
    message, refusal = outcome(ros.MessageError, unpacked, kind, data)
    assert isinstance(message, kind) or refusal


@MANY
@given(text=st.text(), size=st.integers(0, 3))
def test_any_text_is_told_short_and_printable(text, size):
    status = ros.to_status(ros.OK, "name", text * 100**size, {"key": text * 100**size})
    for told in (status.message, status.values[0].value):
        assert len(told) <= 1000
        assert told.isprintable()
