"""A tag's pose from one image: exact, and never the wrong one of the two that may fit."""

import cv2
import numpy as np
import pytest
from cases import each
from drawn_tags import SIZE_M, VGA, corners_px, draw, random_pose

from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.detector import Sighting
from fvs_detector_node.tag_corners import Corners, TagReader
from fvs_detector_node.tag_pose import TagDetector
from fvs_detector_node.tags import Tag
from fvs_ros.camera import CameraModel
from fvs_tools import tag as program

TAG = Tag(tag_size_m=SIZE_M)
SQUARELY = np.diag([1.0, -1.0, -1.0])
MIDDLE = np.array([0.0, 0.0, 0.8])


def angle_rad(rotation, other):
    return float(np.linalg.norm(cv2.Rodrigues(rotation.T @ other)[0]))


def turned(angle_rad):
    return cv2.Rodrigues(np.array([angle_rad, 0.0, 0.0]))[0] @ SQUARELY


def grey(*arguments, **options):
    return draw(*arguments, **options)[..., 0].copy()


def corners(px, noise_px=0.0, rng=None):
    """Corners with noise, and with its covariance."""
    off_px = rng.normal(0.0, noise_px, (4, 2)) if noise_px else 0.0
    return Corners(px + off_px, noise_px**2 * np.eye(8))


def look(detector, rgb, stamp_s=0.0):
    return detector.detect(stamp_s, rgb, None, CameraModel(VGA))


# --- corners ---


@each("name", ["4X4_50", "APRILTAG_16h5", "ARUCO_ORIGINAL"])
def test_every_family_is_read(name):
    pose = turned(0.5), MIDDLE
    tags, why = TagReader(Tag(tag_dictionary=name, tag_id=3)).read(grey([(3, *pose)], name=name))
    assert tags, why
    assert np.abs(tags[3].px - corners_px(*pose)).max() < 0.15


@each(
    ("tags", "options", "words"),
    [
        ([], {}, "not in view: is it covered"),
        ([(5, turned(0.5), MIDDLE)], {}, "seen are [5]: is the number right?"),
        ([(0, turned(0.5), MIDDLE)], {"mirrored": True}, "print not mirrored"),
        ([(0, turned(0.5), MIDDLE)], {"name": "4X4_50"}, "is tag_dictionary right"),
        ([(0, turned(0.5), MIDDLE + [x, 0, 0]) for x in (-0.1, 0.1)], {}, "2 tags have"),
    ],
)
def test_what_is_wrong_with_a_view_is_said(tags, options, words):
    corners, why = TagReader(TAG).read(grey(tags, **options))
    assert not corners
    assert words in why


def smeared(image, rng):
    """As if the tag had moved by eight pixels during the exposure."""
    angle, kernel = rng.uniform(0.0, np.pi), np.zeros((15, 15), np.float32)
    end = 4.0 * np.array([np.cos(angle), np.sin(angle)])
    for u, v in np.linspace(7.0 - end, 7.0 + end, 81):
        kernel[round(v), round(u)] += 1.0
    return cv2.filter2D(image, -1, kernel / kernel.sum())


def shiny(image, rng):
    """With a reflection of the lamp on the print."""
    u, v = np.argwhere(image < 40).mean(axis=0)[::-1] + rng.uniform(-5.0, 5.0, 2)
    return cv2.circle(image.copy(), (round(u), round(v)), 8, 255, cv2.FILLED)


@each(("disturbed", "least_poses"), [(smeared, 22), (shiny, 20)])
def test_disturbed_images_are_read_as_exactly_as_the_covariance_says(disturbed, least_poses):
    rng, deviations, poses = np.random.default_rng(8), [], 0
    for k in range(40):
        rotation, position_m = random_pose(rng, 1.0)
        position_m = 0.7 * position_m
        image = disturbed(grey([(0, rotation, position_m)], noise=0.0), rng)
        image = np.rint(image + rng.normal(0.0, 1.5, image.shape)).clip(0, 255).astype(np.uint8)
        seen, _ = TagReader(TAG).read(image)
        if not seen:
            continue
        off_px = seen[0].px - corners_px(rotation, position_m)
        deviations.append(np.sqrt(np.square(off_px).sum() / np.trace(seen[0].covariance_px2)))
        pose = TagDetector(DetectorConfig(tag=TAG)).find(float(k), seen, VGA).detection
        if pose is not None:
            poses += 1
            assert angle_rad(pose.rotation, rotation) < np.radians(5.0)  # no mirror image
            assert abs(pose.position_m @ position_m / (position_m @ position_m) - 1.0) < 0.02
    assert poses >= least_poses
    assert 0.5 < np.median(deviations) < 2.0
    assert np.max(deviations) < 6.0


def distorted(rgb, coefficients):
    u, v = np.meshgrid(np.arange(640, dtype=np.float32), np.arange(480, dtype=np.float32))
    matrix = np.array([[615.0, 0, 319.5], [0, 615.0, 239.5], [0, 0, 1]])
    points = np.stack([u.ravel(), v.ravel()], 1)[:, None]
    ideal = cv2.undistortPoints(points, matrix, np.array(coefficients), P=matrix)
    return cv2.remap(rgb, *np.moveaxis(ideal.reshape(480, 640, 2), -1, 0), cv2.INTER_LINEAR)


def test_a_lens_that_nobody_declared_is_noticed_before_poses_are_off():
    rng, published, refused = np.random.default_rng(12), [], 0
    for k in range(40):
        rotation, position_m = random_pose(rng, 1.0)
        rgb = distorted(draw([(0, rotation, 0.6 * position_m)], rng=rng), (-0.3, 0.1, 0.0, 0.0))
        sighting = look(TagDetector(DetectorConfig(feature="pose", tag=TAG)), rgb, k / 30.0)
        refused += "that camera_info does not declare" in sighting.problem
        if sighting.detection is not None:
            published.append(angle_rad(sighting.detection.rotation, rotation))
    assert refused > 20
    assert len(published) > 5
    assert np.max(published) < np.radians(5.0)


# --- the pose ---


def test_of_two_poses_that_fit_the_wrong_one_is_never_taken():
    rng = np.random.default_rng(1)
    finder, unsure = TagDetector(DetectorConfig(tag=TAG)), 0
    for k in range(1500):
        rotation, position_m = random_pose(rng)
        seen = {0: corners(corners_px(rotation, position_m), 0.1, rng)}
        pose = finder.find(float(k), seen, VGA).detection
        if pose is None:
            unsure += 1
            continue
        # Squarely seen, poses up to 0.2 rad apart may be one, in the noise.
        assert angle_rad(pose.rotation, rotation) < 0.25
    assert unsure < 0.2 * 1500


def test_a_tag_seen_squarely_is_certain_only_after_a_view_at_an_angle():
    finder, rng = TagDetector(DetectorConfig(tag=TAG)), np.random.default_rng(2)

    def find(stamp_s, tilt_rad):
        seen = corners(corners_px(turned(tilt_rad), 1.5 * MIDDLE), 0.1, rng)
        return finder.find(stamp_s, {0: seen}, VGA).detection

    assert find(0.0, 0.2) is None
    for k, tilt_rad in enumerate(np.linspace(0.7, 0.2, 50)):
        pose = find(1.0 + k / 30.0, tilt_rad)
        assert pose is not None
        assert angle_rad(pose.rotation, turned(tilt_rad)) < 0.1
    finder.reset()
    assert find(9.0, 0.2) is None


# --- several tags on one body ---


def drawn_body(tag, rotation, position_m, rng, hidden=()):
    faces = [(n, tag.faces[n]) for n in tag.facing(rotation, position_m) if n not in hidden]
    return grey(
        [(n, rotation @ face.rotation, position_m + rotation @ face.middle_m) for n, face in faces],
        rng=rng,
    )


@pytest.mark.parametrize("layout", ["plate", "cube"])
def test_a_body_of_tags_is_seen_more_exactly_and_survives_a_hidden_one(layout):
    tag, rng = Tag(tag_size_m=SIZE_M, tag_layout=layout), np.random.default_rng(4)
    off, several = {(): [], (0,): []}, 0
    while len(off[()]) < 25:
        rotation, position_m = random_pose(rng, 0.9)
        if position_m[2] > 0.9 or np.abs(position_m[:2]).max() > 0.15:
            continue  # too small, or not all in the image
        for hidden, errors_m in off.items():
            reader, finder = TagReader(tag), TagDetector(DetectorConfig(tag=tag))
            seen, _ = reader.read(drawn_body(tag, rotation, position_m, rng, hidden))
            sighting = finder.find(0.0, seen, VGA) if seen else Sighting(None)
            pose = sighting.detection
            if pose is None:
                assert hidden or "two poses fit" in sighting.problem
                continue
            several += len(seen) > 1
            assert angle_rad(pose.rotation, rotation) < 0.1  # no mirror image
            errors_m.append(np.linalg.norm(pose.position_m - position_m))
    assert several > 10
    assert np.median(off[()]) < 4e-4
    assert len(off[(0,)]) > 10
    assert np.median(off[(0,)]) < 1.5e-3


def test_a_wrong_layout_is_refused_for_good():
    """Nothing is learned from what is refused, or it would be taken for noise."""
    tag, rng = Tag(tag_size_m=SIZE_M, tag_layout="plate"), np.random.default_rng(6)
    finder = TagDetector(DetectorConfig(tag=tag))
    for k in range(40):
        rotation, position_m = turned(0.5 + 0.01 * k), 0.7 * MIDDLE + [0.003 * k, 0.0, 0.0]
        seen = {
            number: corners(
                corners_px(rotation, position_m + rotation @ (1.1 * face.middle_m)), 0.03, rng
            )
            for number, face in tag.faces.items()
        }
        sighting = finder.find(k / 30.0, seen, VGA)
        assert sighting.detection is None
        assert "is tag_layout right" in sighting.problem


def test_the_tags_of_a_cube_are_its_print_folded_back():
    tag = Tag(tag_layout="cube", tag_id=7)
    outward = np.array([face.rotation[:, 2] for face in tag.faces.values()])
    np.testing.assert_allclose(
        outward, [[0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], atol=1e-12
    )
    for face in tag.faces.values():
        half_m = 0.5 * tag.pitch_m
        np.testing.assert_allclose(face.middle_m, half_m * face.rotation[:, 2], atol=1e-12)
    # Beside a fold of the print is beside an edge of the cube.
    right = tag.faces[8]
    assert right.corners_m[0, 2] > right.corners_m[1, 2]


# --- the detector ---


def test_a_lens_that_distorts_changes_nothing():
    camera = CameraModel(VGA, "plumb_bob", (0.1, -0.05, 0.001, 0.001, 0.0))
    rotation, position_m = turned(0.5), MIDDLE + [0.15, 0.1, 0.0]
    bent = distorted(draw([(0, rotation, position_m)], noise=0.0), camera.coefficients)
    detector = TagDetector(DetectorConfig(feature="pose", tag=TAG))
    tag = detector.detect(0.0, bent, None, camera).detection
    assert np.linalg.norm(tag.position_m - position_m) < 3e-3


# --- the page that is printed ---


def test_a_page_shows_the_tag_in_true_size(tmp_path):
    path, family, number = tmp_path / "tag.png", "4X4_50", 7
    arguments = ["-o", str(path), "--dictionary", family, "--id", str(number), "--size-m", "0.08"]
    assert program.main(arguments) == 0
    page = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert page.shape == pytest.approx((297.0 / 25.4 * 600, 210.0 / 25.4 * 600), abs=1.0)
    corners, why = TagReader(Tag(family, number)).read(page)
    assert corners, why
    tag = corners[number].px
    sides_mm = np.linalg.norm(np.roll(tag, -1, axis=0) - tag, axis=1) * 25.4 / 600
    np.testing.assert_allclose(sides_mm, 80.0, atol=0.1)


def test_a_page_shows_all_tags_of_a_layout_at_their_places(tmp_path):
    path, tag = tmp_path / "tags.png", Tag(tag_size_m=0.04, tag_layout="cube")
    assert program.main(["-o", str(path), "--layout", "cube", "--size-m", "0.04"]) == 0
    corners, why = TagReader(tag).read(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
    assert len(corners) == 5, why
    apart_mm = np.linalg.norm(corners[1].px.mean(axis=0) - corners[0].px.mean(axis=0)) * 25.4 / 600
    assert apart_mm == pytest.approx(50.0, abs=0.05)  # with the border of one cell


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--size-m", "0.2"], "single with tags of at most 0.152 m"),
        (["--dictionary", "36h11"], "tag_dictionary must be one of"),
        (["--id", "9999"], "tag 9999 is not in APRILTAG_36h11"),
        (["-o", "tag.jpg"], "expected a file that ends in .pdf or .png"),
        (["-o", "/proc/no/tag.pdf"], "/proc/no/tag.pdf cannot be written"),
    ],
)
def test_what_cannot_be_printed_is_refused(arguments, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert program.main(arguments) == 2
    assert words in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_an_opencv_that_is_too_old_for_tags_is_said(capsys, tmp_path, monkeypatch):
    """Ubuntu 24.04 has 4.6."""
    monkeypatch.delattr(cv2.aruco, "ArucoDetector")
    assert program.main(["-o", str(tmp_path / "tag.pdf")]) == 2
    assert "tags need OpenCV 4.7 or newer" in capsys.readouterr().err


def test_the_usual_page_is_a_pdf(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert program.main([]) == 0
    assert (tmp_path / "tag.pdf").read_bytes().startswith(b"%PDF")
