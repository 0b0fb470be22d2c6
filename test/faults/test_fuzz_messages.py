"""Any message at all: finite arrays of the right shape, or the one error that callers expect."""

import math

import numpy as np
import pytest
from cases import each
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, PointStamped, Pose, PoseStamped, Quaternion
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, JointState, RegionOfInterest
from std_msgs.msg import Float64MultiArray, Header, MultiArrayDimension, MultiArrayLayout, String

from fvs_ros import ros
from fvs_ros.joints import UR_JOINT_NAMES, JointMap, JointStateError
from fvs_ros.kinds.ball import Ball
from fvs_ros.kinds.pose import Pose as PoseKind
from fvs_ros.ros.inputs import unpacked

MANY = settings(max_examples=200, derandomize=True, deadline=None)
NUMBER, UINT32 = st.floats(width=64), st.integers(0, 2**32 - 1)
NAME = st.one_of(st.sampled_from([*UR_JOINT_NAMES, "left_elbow_joint", ""]), st.text(max_size=8))
HEADER = st.builds(Header, frame_id=st.sampled_from(["camera", "camera", "", "map"]))
POINT = st.builds(Point, x=NUMBER, y=NUMBER, z=NUMBER)
COMPONENT = st.one_of(NUMBER, st.sampled_from([0.0, 1.0]))
DIMENSIONS = st.one_of(st.sampled_from([[], [3, 6], [15, 3]]), st.lists(UINT32, max_size=4)).map(
    lambda sizes: [MultiArrayDimension(size=size) for size in sizes]
)


def numbers(*sizes, ordinary=1.0):
    """Lists of numbers, mostly ordinary ones and of one of these sizes."""
    good = [st.lists(st.floats(-ordinary, ordinary), min_size=n, max_size=n) for n in sizes]
    return st.one_of(*good, st.lists(NUMBER, max_size=20))


MATRIX = st.builds(
    Float64MultiArray,
    layout=st.builds(MultiArrayLayout, dim=DIMENSIONS, data_offset=UINT32),
    data=numbers(18, 49),
)
INFO = st.builds(
    CameraInfo,
    width=UINT32 | st.just(640),
    height=UINT32 | st.just(480),
    k=st.lists(NUMBER, min_size=9, max_size=9)
    | st.just([600.0, 0.0, 320.0, 0.0, 600.0, 240.0, 0.0, 0.0, 1.0]),
    d=numbers(5, 8, ordinary=0.5),
    distortion_model=st.sampled_from(["", "plumb_bob", "rational_polynomial", "equidistant"]),
    binning_x=st.integers(0, 3),
    binning_y=UINT32 | st.just(0),
    roi=st.builds(RegionOfInterest, width=UINT32 | st.just(0), height=UINT32 | st.just(0)),
)
NAMES = st.lists(NAME, max_size=9) | st.permutations(UR_JOINT_NAMES)
JOINTS = st.builds(JointState, name=NAMES, position=numbers(6, 7, ordinary=7.0))
POSE = st.builds(
    PoseStamped,
    header=HEADER,
    pose=st.builds(
        Pose,
        position=POINT,
        orientation=st.builds(Quaternion, x=COMPONENT, y=COMPONENT, z=COMPONENT, w=COMPONENT),
    ),
)


KIND = PoseKind()


def chain_arrays(message):
    chain = ros.from_chain(message, 6)
    return chain.axes, chain.points_m, chain.feature_m, chain.reference_rad


#: What is drawn, what reads it, and the shapes of what it then holds.
READERS = {
    "joint states": (
        JOINTS,
        lambda m: [JointMap(UR_JOINT_NAMES).positions(m.name, m.position)],
        [(6,)],
    ),
    "point": (
        st.builds(PointStamped, header=HEADER, point=POINT),
        lambda m: [ros.from_feature(m, Ball(), "camera", "ball_position")],
        [(3,)],
    ),
    "pose": (POSE, lambda m: [ros.from_feature(m, KIND, m.header.frame_id, "tool_pose")], [(12,)]),
    "jacobian": (MATRIX, lambda m: [ros.from_jacobian(m, 6)], [(3, 6)]),
    "chain": (MATRIX, chain_arrays, [(6, 3), (6, 3), (3,), (6,)]),
}


def unless_refused(read, *arguments):
    """What a message says; None if it is refused with a sentence."""
    try:
        return read(*arguments)
    except (ros.MessageError, JointStateError) as refusal:
        if not str(refusal):
            raise
        return None


@each("name", READERS)
def test_a_message_is_finite_arrays_of_the_right_shape_or_refused_in_words(name):
    messages, read, shapes = READERS[name]

    @MANY
    @given(message=messages)
    def holds(message):
        arrays = list(unless_refused(read, message) or [])
        assert not arrays or [value.shape for value in arrays] == shapes
        assert all(value.dtype == np.float64 and np.isfinite(value).all() for value in arrays)

    holds()


@MANY
@given(message=INFO)
def test_a_camera_info_is_a_camera_or_refused_in_words(message):
    camera = unless_refused(ros.from_camera_info, message)
    if camera is not None:
        sizes = [v for v in vars(camera.intrinsics).values() if isinstance(v, (int, float))]
        assert all(map(math.isfinite, sizes))
        assert min(camera.intrinsics.fx, camera.intrinsics.fy) > 0.0


@each("velocity", [np.full(6, np.nan), np.array([0.0] * 5 + [np.inf]), np.zeros((2, 3))])
def test_a_command_that_is_not_finite_numbers_is_never_made(velocity):
    with pytest.raises(ros.MessageError):
        ros.to_command(velocity)


@MANY
@given(
    text=st.text(),
    size=st.integers(0, 3),
    values=st.dictionaries(
        st.text(max_size=5), st.one_of(NUMBER, st.none(), st.text(), st.booleans()), max_size=5
    ),
)
def test_a_status_is_short_and_printable_and_keeps_its_keys(text, size, values):
    status = ros.to_status(ros.OK, "name", text * 100**size, values)
    for word in (status.message, *(pair.value for pair in status.values)):
        assert len(word) <= 1000
        assert word.isprintable()
    assert list(ros.from_status(status)) == list(values)


def with_dimensions(count):
    return Float64MultiArray(layout=MultiArrayLayout(dim=[MultiArrayDimension()] * count))


@each(
    ("small", "large"),
    [
        (*(PointStamped(header=Header(frame_id=frame)) for frame in ("camera", "x" * 10**6)),),
        (with_dimensions(2), with_dimensions(10**5)),
        (Float64MultiArray(data=[0.0] * 18), Float64MultiArray(data=[0.0] * 10**5)),
        (JointState(name=["joint"] * 100), JointState(name=["joint"] * 10**4)),
        (DiagnosticStatus(values=[KeyValue()] * 50), DiagnosticStatus(values=[KeyValue()] * 10**4)),
        (String(data="<robot/>" * 10**4), String(data="<robot/>" * 10**6)),
    ],
)
def test_a_message_is_unpacked_unless_it_is_too_large(small, large):
    assert unpacked(type(small), serialize_message(small)) == small
    with pytest.raises(ros.MessageError, match="expected at most"):
        unpacked(type(large), serialize_message(large))


@MANY
@given(kind=st.sampled_from([JointState, PointStamped, Float64MultiArray]), data=st.binary())
def test_any_bytes_are_a_message_or_refused(kind, data):
    assert isinstance(unless_refused(unpacked, kind, data), (kind, type(None)))
