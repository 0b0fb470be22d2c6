"""Still poses, tables and bags of any arm calibrate a camera and train a model."""

import re
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from recordings import relative_error, seen_from_anywhere
from replayed_bags import joint_states, point
from scipy.spatial.transform import Rotation
from test_calibration import ARM, TAG, URDF, collected, errors

from fvs_estimator_node.chain_fit import ChainFitError, fit_chain
from fvs_estimator_node.files import DataSet, load_data_set, save_data_set
from fvs_tools.bag import Bag
from fvs_tools.calibrate import main
from fvs_tools.calibration import calibrate, report, verdict
from fvs_tools.recorded import read_data_set
from fvs_tools.table import read_table

POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")


def stills(feature="pose", on_arm=False, count=30):
    """Some images of a motion, each as of an arm that stood still."""
    data = collected(feature, on_arm=on_arm, seconds=60.0)
    chosen = np.linspace(0, len(data) - 1, count).astype(int)
    columns = {name: getattr(data, name)[chosen] for name in ("stamps_s", "joints_rad", "z")}
    return replace(data, **columns, segment=np.arange(count), still=True)


@pytest.mark.parametrize(("feature", "on_arm"), [("ball", False), ("pose", True)])
def test_still_poses_tell_where_the_camera_is(feature, on_arm):
    estimate = calibrate(stills(feature, on_arm), ARM, on_arm)
    off_m, off_rad, _ = errors(estimate)
    assert off_m < min(2e-3, 3.0 * estimate.deviation_m)
    assert off_rad < np.radians(0.1)
    assert verdict(estimate)[0] != "unusable"
    assert "late" not in report(estimate)  # arms at rest do not tell


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda data: replace(data, joints_rad=np.degrees(data.joints_rad)), "metres|no arm"),
        (lambda data: replace(data, z=data.z[::-1]), "no arm"),
        (lambda _: stills("ball", count=9), "at least 10"),
    ],
)
def test_still_poses_that_no_camera_explains_are_refused(change, words):
    with pytest.raises(ValueError, match=words):
        calibrate(change(stills()), ARM)


def test_a_chain_is_fitted_to_still_poses(tmp_path):
    """Of six joints, to a half percent, with 1 mm of noise; the file keeps that they are still."""
    rng = np.random.default_rng(0)
    chain = seen_from_anywhere(rng)
    joints = chain.reference_rad + rng.uniform(-0.6, 0.6, (60, 6))
    seen_m = chain.position(joints) + rng.normal(0.0, 1e-3, (60, 3))
    data = DataSet(np.arange(60.0), joints, seen_m, np.arange(60), still=True)
    save_data_set(tmp_path / "stills.npz", data)
    fit = fit_chain(load_data_set(tmp_path / "stills.npz"))
    probes = chain.reference_rad + rng.uniform(-0.5, 0.5, (200, 6))
    assert np.median(relative_error(fit.chain.jacobian(probes), chain.jacobian(probes))) < 0.006
    few = {name: getattr(data, name)[:20] for name in ("stamps_s", "joints_rad", "z")}
    few = replace(data, **few, segment=np.arange(20))
    with pytest.raises(ChainFitError, match="at least 27 still poses, the data set has 20"):
        fit_chain(few)


def bag_of(folder, data, published, topic="ball_position"):
    """A bag of images of a ball, each after what is published of the joints by then."""
    with closing(Bag(folder, {})) as bag:
        for stamp_s, joints, ball in zip(data.stamps_s, data.joints_rad, data.z, strict=True):
            for sent in (*published(stamp_s, joints), point(topic, stamp_s, stamp_s, ball)):
                bag.write(sent)
    return folder


def test_a_bag_of_still_poses_leaves_out_images_in_motion(tmp_path):
    """An image every three seconds; at the last two the arm moved on."""
    data = replace(stills("ball", count=14), stamps_s=3.0 * np.arange(14))

    def published(image_s, joints):
        speed_rad_s = 0.3 * (image_s >= data.stamps_s[12])
        for ahead_s in np.arange(-0.4, 0.1, 0.02):
            stamp_s = image_s + ahead_s
            yield joint_states(stamp_s, stamp_s, ARM.names, joints + ahead_s * speed_rad_s)

    read = read_data_set(bag_of(tmp_path / "bag", data, published), ARM.names)
    assert read.still
    np.testing.assert_allclose(read.joints_rad, data.joints_rad[:12])
    assert read.provenance["left_out"].startswith("2 images of still poses show the arm in motion")
    assert errors(calibrate(read, ARM))[0] < 3e-3


# --- tables ---


def poses(places_m, rotations):
    """Rows x, y, z, qx, qy, qz, qw."""
    return np.hstack([places_m, Rotation.from_matrix(rotations).as_quat()])


def test_a_table_of_hand_poses_needs_no_urdf_and_no_common_clock(tmp_path):
    """Hand and tag at rates of their own, in lines of their own, with images 20 ms late."""
    data, path = collected("pose", delay_s=0.02, seconds=60.0), tmp_path / "poses.csv"
    axes, hands_m = ARM.tip_at(data.joints_rad)
    hands = poses(hands_m, np.swapaxes(axes, 1, 2))
    tags = poses(data.z[:, :3], [data.kind.rotation(data.kind.nearest(z)) for z in data.z])
    nothing, stamps_s = np.full_like(tags, np.nan), data.stamps_s
    of_hand = np.column_stack([stamps_s + 1e-3, hands, nothing])
    of_tag = np.column_stack([stamps_s, nothing, tags])[::2]
    head = ", ".join(["stamp_s", *(f"hand_{name}" for name in POSE), *POSE])
    np.savetxt(path, np.vstack([of_hand, of_tag]), "%.17g", ", ", header=head, comments="")
    path.write_text(path.read_text("utf-8").replace("nan", ""), "utf-8")
    table, arm = read_table(path)
    assert not table.still
    estimate = calibrate(table, arm)
    off_m, off_rad, _ = errors(estimate)
    assert off_m < 2e-3
    assert off_rad < np.radians(0.1)
    assert estimate.mean.delay_s.item() == pytest.approx(0.019, abs=1e-3)
    np.testing.assert_allclose(estimate.target[:3], TAG[0], atol=2e-3)
    np.testing.assert_array_less(np.abs(estimate.mean.zeros), 1e-5)


def test_joints_that_a_driver_wraps_go_on_in_a_table_of_motion(tmp_path):
    path, joints_rad = tmp_path / "wrapped.csv", 3.0 + np.arange(0.0, 1.0, 0.01)
    lines = [f"{0.05 * t:.2f},{np.angle(np.exp(1j * q))},1,2,3" for t, q in enumerate(joints_rad)]
    path.write_text("\n".join(["stamp_s,a,x,y,z", *lines]))
    np.testing.assert_allclose(np.diff(read_table(path)[0].joints_rad[:, 0]), 0.01)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a,x,y\n1,2,3", "no column z"),
        ("x,y,z\n1,2,3", "of a joint"),
        ("a,x,y,z\n1,2,3", "line 2 has 3 cells"),
        ("a,a,x,y,z\n1,2,3,4,5", "names a column twice"),
        ("a,x,y,z\n1,2,,4", "line 2 lacks a number"),
        ("a,x,y,z\n1,2,3,4\ninf,2,3,4", "line 3 lacks a number of a"),
        ("stamp_s,a,x,y,z\n1,1,2,3,4\n,1,2,3,4", "line 3 lacks a stamp_s"),
        ("a,x,y,z,image\n1,2,3,4,a.png", "column image: expected a number"),
        ("a,x,y,z\n1,2,3,4\n1,2", "line 3 has 2 cells"),
        ("stamp_s,a,x,y,z\n1,1,2,3,4\n2,l.5,,,", "line 3, column a: expected a number"),
        ("a,x,y,z\n1,2,3,4\n2,,,", "1 of 1 images"),
        ("a,x,y,z,qx,qy,qz,qw\n1,2,3,4,0,0,0,2", "is no pose"),
        ("stamp_s,a,x,y,z\n1,1,,,\n3,,1,1,1", "0 of 1 images"),
        ("", "of a joint"),
    ],
)
def test_a_table_that_cannot_be_read_is_refused_in_words(tmp_path, text, words):
    path = tmp_path / "table.csv"
    path.write_text(text, "utf-8")
    with pytest.raises(ValueError, match=words) as error:
        read_table(path)
    assert str(path) in str(error.value)


# --- bags ---


@pytest.fixture
def bag(tmp_path):
    """Joints in another order, with one more, and a ball; and joints of a gripper."""
    names = [*ARM.names[::-1], "finger"]

    def published(stamp_s, joints):
        at, angles = (stamp_s, stamp_s), np.append(joints[::-1], np.nan)
        yield joint_states(*at, names, angles, topic="arm/joint_states")
        yield joint_states(*at, ["finger"], [0.0], topic="gripper")

    return bag_of(tmp_path / "bag", collected(seconds=20.0), published, "arm/ball_position")


def test_a_bag_of_any_arm_calibrates_its_camera(bag):
    data = read_data_set(bag, ARM.names)
    assert len(data) > 500
    assert data.joint_names == ARM.names, "but not the finger's, which are no numbers"
    assert data.feature_frame == "camera"
    assert errors(calibrate(data, ARM))[0] < 2e-3


@pytest.mark.parametrize(
    ("topics", "words"),
    [
        ({"feature": "/nowhere"}, "0 topics of PointStamped or .* called /nowhere"),
        ({"joint_states": "/gripper"}, r"joint_states names \['finger'\], none of the wanted"),
    ],
)
def test_topics_are_chosen_or_named(bag, topics, words):
    with pytest.raises(ValueError, match=words):
        read_data_set(bag, ARM.names, **topics)


def in_halves(stamp_s, joints):
    halves = slice(0, 3), slice(3, 6)
    return [joint_states(stamp_s, stamp_s, ARM.names[half], joints[half]) for half in halves]


def beside_zeros(stamp_s, joints):
    later_s = stamp_s + 0.003
    zeros = joint_states(later_s, later_s, ARM.names, np.zeros(6))
    return [joint_states(stamp_s, stamp_s, ARM.names, joints), zeros]


@pytest.mark.parametrize(
    ("published", "words"),
    [
        (beside_zeros, "jumped by .* do two nodes publish joint states"),
        (in_halves, r"joint_states lacks .* it names"),
        (lambda _, q: [joint_states(1.0, None, ARM.names, q)], "joint_states has no stamp"),
        (lambda t, q: [joint_states(t, t, ARM.names, np.degrees(q))], "no degrees|in degrees"),
    ],
)
def test_why_joint_states_cannot_be_used_is_said(tmp_path, capsys, published, words):
    bag_of(tmp_path / "bag", collected(seconds=8.0), published)
    out = ["-o", str(tmp_path / "camera.yaml")]
    assert main([str(tmp_path / "bag"), "--urdf", str(URDF), *out]) == 2
    assert re.search(words, capsys.readouterr().err)
