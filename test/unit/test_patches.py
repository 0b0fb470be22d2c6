"""Click and track: any patch of drawn images is followed, or is said to be lost."""

import cv2
import numpy as np
import pytest
from cases import each

from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.detectors import make_detector
from fvs_ros.camera import CameraModel, Intrinsics
from fvs_ros.kinds.points import Points

WIDTH, HEIGHT, HALF = 320, 240, 30
CAMERA = CameraModel(Intrinsics.of_pixels(WIDTH, HEIGHT))


def texture(rng, height, width):
    """Coarse and fine spots, grey levels."""
    grey = np.zeros((height, width), np.float32)
    for size in (2, 4, 8, 16):
        spots = rng.normal(size=(height // size + 3, width // size + 3)).astype(np.float32)
        grey += cv2.resize(spots, (width, height), interpolation=cv2.INTER_CUBIC)
    return 128.0 + 22.0 * grey


class Scene:
    """A textured piece before a textured wall, and noise of 3 grey levels."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)
        self.wall = texture(self.rng, HEIGHT, WIDTH)
        self.piece = texture(self.rng, 2 * HALF + 1, 2 * HALF + 1)

    def draw(self, middles_px, turned=0.0, scale=1.0, blur_px=0.0, cover=False):
        """An image with the piece at one or several points, (n, 2)."""
        image = self.wall.copy()
        for middle in np.atleast_2d(middles_px):
            shape = scale * np.array(
                [[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]]
            )
            pose = np.column_stack([shape, middle - shape @ [HALF, HALF]])
            shown = cv2.warpAffine(np.ones_like(self.piece), pose, (WIDTH, HEIGHT))
            image += shown * (cv2.warpAffine(self.piece, pose, (WIDTH, HEIGHT)) - image)
        image = cv2.GaussianBlur(image, (0, 0), 0.7 + blur_px)
        if cover:
            image[60:180, 60:260] = texture(self.rng, 120, 200)
        image += 3.0 * self.rng.normal(size=image.shape)
        return cv2.cvtColor(np.clip(image, 0, 255).astype(np.uint8), cv2.COLOR_GRAY2RGB)


def tracker(*px):
    return make_detector(DetectorConfig(feature="points", points=Points(len(px) // 2), track_px=px))


def look(detector, image):
    sighting = detector.detect(0.0, image, None, CAMERA)
    assert (sighting.detection is None) == bool(sighting.problem)
    return sighting


@each(
    ("period", "turned", "scale", "blur_px"),
    [(80.0, 0.0, 0.0, 0.0), (15.0, 0.0, 0.0, 0.0), (80.0, 1.5, 0.3, 0.0), (40.0, 0.5, 0.2, 1.0)],
)
def test_a_patch_that_moves_turns_grows_and_blurs_is_followed_without_drift(
    period, turned, scale, blur_px
):
    scene, detector, errors_px = Scene(1), tracker(160.0, 120.0), []
    for k in range(200):
        phase = 2.0 * np.pi * k / period
        middle = 40.0 * np.sin([phase, 0.7 * phase]) + [160.0, 120.0]
        pose = turned * np.sin(0.5 * phase), 1.0 + scale * np.sin(0.3 * phase)
        detection = look(detector, scene.draw(middle, *pose, blur_px * (k % 2))).detection
        errors_px.append(detection.px[0] - middle)
    assert np.abs(errors_px).max() < 0.3
    assert np.sqrt(np.mean(np.square(errors_px))) < 0.1


def test_a_covered_patch_is_lost_and_found_only_where_it_is_itself():
    scene, px = Scene(2), np.array([160.0, 120.0])
    detector = tracker(*px)
    for k in range(10):
        look(detector, scene.draw(px + [k, 0.0]))
    for _ in range(100):  # anything else in its place
        assert "point 1 of track_px is lost" in look(detector, scene.draw(px, cover=True)).problem
    back = px + [30.0, 20.0]
    np.testing.assert_allclose(look(detector, scene.draw(back)).detection.px[0], back, atol=0.2)
    look(detector, scene.draw(back, cover=True))
    away = back + [-90.0, 0.0]
    for _ in range(5):  # out of reach, so it is not looked for there
        assert "is lost" in look(detector, scene.draw(away)).problem


def test_a_patch_that_is_covered_little_by_little_is_lost_before_it_is_off():
    scene, px = Scene(2), np.array([160.0, 120.0])
    detector, cover = tracker(*px), scene.draw([0.0, 0.0])
    for edge in range(140, 180):
        image = scene.draw(px)
        image[:, :edge] = cover[:, 320 - edge :]
        sighting = look(detector, image)
        if sighting.detection is not None:
            np.testing.assert_allclose(sighting.detection.px[0], px, atol=1.0)
    assert sighting.detection is None


def test_of_two_that_look_alike_the_one_that_was_chosen_is_followed():
    scene, start = Scene(3), np.array([100.0, 120.0])
    detector = tracker(*start)
    for k in range(60):
        middle = start + [2.0 * k, 0.0]
        found = look(detector, scene.draw([[160.0, 76.0], [160.0, 164.0], middle])).detection
        np.testing.assert_allclose(found.px[0], middle, atol=0.3)
    look(detector, scene.draw(middle, cover=True))
    both = [middle + [-34.0, 0.0], middle + [34.0, 0.0]]
    assert "is lost" in look(detector, scene.draw(both)).problem


def test_several_points_are_followed_together_and_a_missing_one_is_named():
    scene = Scene(4)
    detector = tracker(150.0, 110.0, 170.0, 110.0, 160.0, 135.0)
    shift = np.array([12.0, -7.0])
    look(detector, scene.draw([160.0, 120.0]))
    found = look(detector, scene.draw([160.0, 120.0] + shift)).detection.px
    np.testing.assert_allclose(found - shift, [[150, 110], [170, 110], [160, 135]], atol=0.3)
    image = scene.draw([160.0, 120.0] + shift)
    image[120:, :] = 90
    assert "point 3 of track_px is lost" in look(detector, image).problem


def test_what_cannot_be_followed_is_said():
    scene = Scene(5)
    image = scene.draw([160.0, 120.0])
    words = "point 1 of track_px is not in the image"
    assert words in look(tracker(400.0, 120.0), image).problem
    edge = np.where(np.arange(WIDTH) < 160, 60, 200) + 3.0 * scene.rng.normal(size=(HEIGHT, WIDTH))
    edge = cv2.cvtColor(np.clip(edge, 0, 255).astype(np.uint8), cv2.COLOR_GRAY2RGB)
    for u in (160.0, 80.0):  # an edge, and a plain wall
        assert "nothing to hold on to" in look(tracker(u, 120.0), edge).problem
    waiting = make_detector(DetectorConfig(feature="points", points=Points(3)))
    assert "nothing is tracked: click on the page" in look(waiting, image).problem
    with pytest.raises(ValueError, match="got 2 numbers"):
        DetectorConfig(track_px=(1.0, 2.0))
