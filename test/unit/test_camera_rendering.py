"""A window of the rendered camera agrees with the pinhole model."""

from contextlib import closing

import numpy as np
import pytest
from drawn_balls import RADIUS_M, draw, red

from fvs_detector_node.images import Region
from fvs_ros.camera import Intrinsics
from fvs_sim_node.camera import RigidPose
from fvs_sim_node.config import SceneObject, SimConfig
from fvs_sim_node.world import Renderer, World

#: Of a sphere far from the arm.
MIDDLE_M = (5.0, 0.0, 1.0)


def test_projection_agrees_to_a_tenth_of_a_pixel():
    camera, rng = Intrinsics(320, 240, 300.0, 310.0, 150.25, 128.0), np.random.default_rng(1)
    window, offsets, areas, depths, shifts = Region(16, 8, 287, 223), [], [], [], []
    with closing(World(SimConfig(objects=(SceneObject(MIDDLE_M, (RADIUS_M,)),)))) as world:
        renderer = Renderer(world.client, camera)
        for _ in range(30):
            u = rng.uniform(0.15, 0.85) * camera.width
            v = rng.uniform(0.15, 0.85) * camera.height
            centre = rng.uniform(0.5, 1.6) * camera.rays(u, v)
            rotation = np.linalg.qr(rng.standard_normal((3, 3)))[0]
            rotation *= np.linalg.det(rotation)
            pose = RigidPose(MIDDLE_M - rotation @ centre, rotation)
            ideal_rgb, ideal_m = (a[window.part] for a in draw([(centre, RADIUS_M)], camera))
            rgb, depth = renderer.render(pose, window)
            ideal, drawn = red(ideal_rgb), red(rgb) & (depth > 0.0)
            offsets.append(np.mean(np.nonzero(drawn), axis=1) - np.mean(np.nonzero(ideal), axis=1))
            coarse_rgb, coarse_m = renderer.render(pose, window, step=3)
            coarse = red(coarse_rgb) & (coarse_m > 0.0)
            shifts.append(np.mean(np.nonzero(coarse), axis=1) - np.mean(np.nonzero(drawn), axis=1))
            areas.append(np.count_nonzero(drawn) / np.count_nonzero(ideal))
            depths.append(np.median((depth - ideal_m)[drawn & ideal]))
    assert np.abs(np.mean(offsets, axis=0)).max() < 0.02
    assert np.abs(offsets).max() < 0.1
    assert np.abs(np.mean(shifts, axis=0)).max() < 0.1
    assert np.mean(areas) == pytest.approx(1.0, abs=0.005)
    assert np.abs(depths).max() < 1e-4


def test_a_pybullet_without_numpy_draws_the_same(monkeypatch):
    def as_tuples(*args, **kwargs):
        return [tuple(np.ravel(part).tolist()) for part in draw_with_numpy(*args, **kwargs)]

    with closing(World(SimConfig(objects=(SceneObject(MIDDLE_M, (RADIUS_M,)),)))) as world:
        renderer = Renderer(world.client, Intrinsics(40, 30, 30.0, 30.0, 20.0, 15.0))
        pose = RigidPose(MIDDLE_M - np.array([0.0, 0.0, 0.5]), np.eye(3))
        rgb, depth_m = renderer.render(pose)
        draw_with_numpy = world.client.getCameraImage
        monkeypatch.setattr(world.client, "getCameraImage", as_tuples, raising=False)
        again_rgb, again_m = renderer.render(pose)
    assert depth_m.any()
    assert np.array_equal(again_rgb, rgb)
    assert np.array_equal(again_m, depth_m)
