"""A webcam's pixels: as simulated, as a chain before the true lens has them, and as detected."""

from dataclasses import replace

import numpy as np
import pytest
from cases import each
from drawn_balls import RADIUS_M, VGA, draw

from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.detectors import make_detector
from fvs_detector_node.tags import Tag
from fvs_ros.camera import CameraModel, Intrinsics
from fvs_ros.kinds.points import Points
from fvs_sim_node.camera import Lens
from fvs_sim_node.config import SimConfig
from fvs_sim_node.simulation import Simulation

PIXELS = CameraModel(Intrinsics.of_pixels(VGA.width, VGA.height))


@each("points, layout, most_px", [(1, "single", 0.6), (4, "single", 0.15), (16, "plate", 0.15)])
def test_what_is_drawn_is_detected_where_the_true_chain_and_lens_have_it(points, layout, most_px):
    tag = Tag(tag_layout=layout)
    config = SimConfig(feature="points", points=Points(points), tag=tag)
    rng, measured = np.random.default_rng(0), 0
    with Simulation(config) as simulation:
        whole = make_detector(DetectorConfig(feature="points", points=Points(points), tag=tag))
        joints = simulation.world.home_rad + rng.uniform(-0.2, 0.2, (8, 6))
        for row in joints:
            simulation.reset(row)
            simulation.full_frames = not measured
            look, truth = simulation.look(), simulation.true_feature()
            np.testing.assert_allclose(simulation.true_chain().position(row), truth, atol=1e-4)
            slopes = simulation.kind.along(simulation.true_chain(), row)[1]
            np.testing.assert_allclose(simulation.true_jacobian(row), slopes)
            if look.z is not None:
                measured += 1
                np.testing.assert_allclose(look.z, truth, atol=most_px)
            if look.z is not None and look.frame is not None:
                seen = whole.detect(0.0, *look.frame, PIXELS).detection
                np.testing.assert_allclose(simulation.kind.of_detection(seen), look.z, atol=0.3)
    assert measured > 3


def test_noise_is_in_pixels_and_nothing_is_reported_out_of_the_picture():
    with Simulation(SimConfig(feature="points", rendered=False, position_noise_m=0.001)) as sim:
        off_px = [sim.look().z - sim.true_feature() for _ in range(400)]
        assert np.std(off_px) == pytest.approx(0.2, rel=0.1)
        for turned_deg in (60.0, 180.0):
            sim.configure(replace(sim.config, camera_rotation_deg=(0.0, turned_deg, 0.0)))
            assert sim.look().z is None


def test_a_pinhole_image_shows_where_each_pixel_of_a_lens_comes_from():
    lens = Lens(640, 480, 500.0, 500.0, 300.0, 250.0, -0.2)
    pinhole, u, v = lens.pinhole()
    expected = np.stack(np.meshgrid(np.arange(640), np.arange(480)), axis=-1)
    np.testing.assert_allclose(lens.project(pinhole.rays(u, v)), expected, atol=1e-3)
    assert pinhole.contains(np.stack([u, v], axis=-1))


def test_a_ball_that_is_half_hidden_keeps_its_centre_and_a_square_has_none():
    detector, middle_m = make_detector(DetectorConfig(feature="points")), np.array([0.1, 0.0, 0.8])
    rgb, _ = draw([(middle_m, RADIUS_M)])
    (u, v), radius_px = VGA.project(middle_m), VGA.fx * RADIUS_M / middle_m[2]
    rgb[int(v + 0.4 * radius_px) :] = 150
    detection = detector.detect(0.0, rgb, None, PIXELS).detection
    np.testing.assert_allclose(detection.px, [[u, v]], atol=0.5)
    red = rgb[int(v), int(u)].copy()
    rgb[:] = 150
    assert "nothing in view" in detector.detect(0.0, rgb, None, PIXELS).problem
    rgb[100:160, 200:260] = red
    assert "not round" in detector.detect(0.0, rgb, None, PIXELS).problem


def test_a_count_that_nothing_has_is_refused():
    with pytest.raises(ValueError, match="a ball, of 1, or tags, of 4 each"):
        Simulation(SimConfig(feature="points", points=Points(3))).close()
    with pytest.raises(ValueError, match=r"u and v of 3 points .* got 4 numbers"):
        DetectorConfig(feature="points", points=Points(3), track_px=(1.0, 2.0, 3.0, 4.0))
    with pytest.raises(ValueError, match="not seen from an object"):
        Simulation(SimConfig(feature="points", object_tag_id=9)).close()
    with pytest.raises(ValueError, match="camera in the room"):
        make_detector(DetectorConfig(feature="points", camera_mount="arm"))


WEBCAMS = SimConfig(feature="points", points=Points(cameras=("front", "side")))


def test_several_webcams_have_lenses_streams_and_chains_of_their_own():
    with Simulation(WEBCAMS) as both, Simulation(SimConfig(feature="points")) as front:
        first, second = both.views
        assert first.lens == front.views[0].lens != second.lens
        assert both.look().z.tolist() == front.look().z.tolist()
        joints, truth = both.joints_rad, both.true_feature()
        for view, rows in zip(both.views, both.kind.rows, strict=True):
            look = both.look(view.number)
            np.testing.assert_allclose(look.z, truth[rows], atol=0.6)
            assert look.camera == view.mounted
        np.testing.assert_allclose(both.true_chain().position(joints), truth, atol=1e-4)
        slopes = both.kind.along(both.true_chain(), joints)[1]
        np.testing.assert_allclose(both.true_jacobian(joints), slopes)
        assert slopes.shape == (4, 6)


def test_each_webcam_has_its_rate_and_latency_and_one_alone_is_covered():
    exact = replace(WEBCAMS, rendered=False, image_rates_hz=(25.0, 12.5), latencies_s=(0.04, 0.12))
    with Simulation(exact) as simulation:

        def images():
            steps = [simulation.advance() for _ in range(125)]
            ages = [(o, step.time_s - o.stamp_s) for step in steps for o in step.observations]
            return [[(o.z, age) for o, age in ages if o.number == number] for number in (0, 1)]

        fast, slow = images()
        assert len(fast) == pytest.approx(2 * len(slow), abs=3)
        assert max(age for _, age in fast) + 0.06 < min(age for _, age in slow)
        one = replace(exact, camera_covered=True, covered_cameras=("side",))
        simulation.configure(one)
        images()
        fast, slow = images()
        assert all(z is not None for z, _ in fast)
        assert all(z is None for z, _ in slow)
        simulation.configure(replace(one, covered_cameras=("",)))
        assert simulation.look().z is simulation.look(1).z is None


def test_a_camera_that_stands_nowhere_is_refused():
    with pytest.raises(ValueError, match=r"unknown camera 'left'.*known are front, overhead, side"):
        replace(WEBCAMS, points=Points(cameras=("left",)))


def test_the_side_camera_of_any_arm_looks_across_the_front_ones_view():
    with Simulation(replace(WEBCAMS, robot="scara")) as simulation:
        front, side = (view.mounted.rotation[:, 2] for view in simulation.views)
        assert 0.0 <= front @ side <= 0.5
        assert all(simulation.look(number).z is not None for number in (0, 1))
