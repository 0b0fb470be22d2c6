"""The rendered camera agrees with the pinhole model, and windows with the full image."""

import numpy as np
import pytest
from drawn_balls import RADIUS_M, VGA, draw, red

from fvs_detector_node.images import Region
from fvs_ros.camera import Intrinsics
from fvs_sim_node.camera import CAMERAS, RigidPose
from fvs_sim_node.config import SceneObject, SimConfig
from fvs_sim_node.robot import HOME_JOINTS_RAD, TRAINING_BOX_RAD
from fvs_sim_node.world import Renderer, World

CENTRE, HALF_BOX = np.array(HOME_JOINTS_RAD), np.array(TRAINING_BOX_RAD)


@pytest.fixture(scope="module")
def world():
    world = World()
    yield world
    world.close()


@pytest.fixture(scope="module")
def lone_ball():
    """A renderer of a sphere at (5, 0, 1), far from the arm."""
    sphere = SceneObject((5.0, 0.0, 1.0), (RADIUS_M,))
    world = World(SimConfig(objects=(sphere,)))
    yield lambda camera: Renderer(world.client, camera)
    world.close()


def test_projection_agrees_to_a_tenth_of_a_pixel(lone_ball):
    camera, rng = Intrinsics(320, 240, 300.0, 310.0, 150.25, 128.0), np.random.default_rng(1)
    renderer = lone_ball(camera)
    offsets, areas, depths = [], [], []
    for _ in range(30):
        u = rng.uniform(0.15, 0.85) * camera.width
        v = rng.uniform(0.15, 0.85) * camera.height
        centre = rng.uniform(0.5, 1.6) * camera.rays(u, v)
        rotation = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        rotation *= np.linalg.det(rotation)
        pose = RigidPose(np.array([5.0, 0.0, 1.0]) - rotation @ centre, rotation)
        ideal_rgb, ideal_depth = draw([(centre, RADIUS_M)], camera)
        rgb, depth = renderer.render(pose)
        ideal, drawn = red(ideal_rgb), red(rgb) & (depth > 0.0)
        offsets.append(np.mean(np.nonzero(drawn), axis=1) - np.mean(np.nonzero(ideal), axis=1))
        areas.append(np.count_nonzero(drawn) / np.count_nonzero(ideal))
        depths.append(np.median((depth - ideal_depth)[drawn & ideal]))
    assert np.abs(np.mean(offsets, axis=0)).max() < 0.02
    assert np.abs(offsets).max() < 0.1
    assert np.mean(areas) == pytest.approx(1.0, abs=0.005)
    assert np.abs(depths).max() < 1e-4


def test_window_equals_crop(world):
    renderer = Renderer(world.client, VGA)
    pose = CAMERAS["front"]
    rng = np.random.default_rng(2)
    for _ in range(3):
        world.reset(CENTRE + HALF_BOX * rng.uniform(-1.0, 1.0, 6))
        world.place_carried()
        whole_rgb, whole_depth = renderer.render(pose)
        for size in (96, 112, 131):
            u0, v0 = int(rng.integers(0, 640 - size)), int(rng.integers(0, 480 - size))
            rgb, depth = renderer.render(pose, Region(u0, v0, size, size))
            part = Region(u0, v0, size, size).part
            np.testing.assert_array_equal(depth > 0.0, whole_depth[part] > 0.0)
            # Depth and shade are interpolated in single precision.
            np.testing.assert_allclose(depth, whole_depth[part], atol=5e-5)
            assert np.abs(rgb.astype(int) - whole_rgb[part]).max() <= 1
