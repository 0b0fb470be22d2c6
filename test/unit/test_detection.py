"""The ball is found where it is, in spite of noise, occluders and other red things."""

import numpy as np
import pytest
from drawn_balls import RADIUS_M, VGA, draw, hide

from fvs_detector_node.detection import BallColour, Cause, colour_mask, detect_ball, examine
from fvs_detector_node.tracking import Region
from fvs_sim_node.depth_noise import add_depth_noise
from fvs_sim_node.rendering import Renderer, camera_preset, pose_from_look_at
from fvs_sim_node.world import TABLE, SceneObject, World

CENTRE = np.array([0.0, -1.35, 1.6, -1.75, -1.57, 0.0])
HALF_BOX = np.array([0.6, 0.5, 0.5, 0.5, 0.5, 0.5])


def error_mm(detection, centre):
    return 1e3 * np.linalg.norm(detection.position_m - centre)


def test_ideal_ball_is_exact():
    rng = np.random.default_rng(0)
    for _ in range(20):
        z = rng.uniform(0.6, 1.8)
        centre = z * VGA.rays(rng.uniform(60, 580), rng.uniform(60, 420))
        detection = detect_ball(*draw([(centre, RADIUS_M)]), VGA, RADIUS_M)
        assert error_mm(detection, centre) < 0.6
        assert detection.visible_fraction == pytest.approx(1.0, abs=0.02)
        assert detection.quality > 0.9
        assert detection.residual_m < 0.001
        np.testing.assert_allclose(detection.pixel, VGA.project(centre), atol=0.3)
        assert detection.radius_px == pytest.approx(VGA.fx * RADIUS_M / z, rel=0.15)


def test_surface_is_not_centre_and_the_correction_runs_along_the_ray():
    centre = np.array([0.55, -0.40, 1.1])
    detection = detect_ball(*draw([(centre, RADIUS_M)]), VGA, RADIUS_M)
    np.testing.assert_allclose(detection.position_m, centre, atol=5e-4)


@pytest.mark.parametrize("shown", [0.75, 0.5, 0.35])
@pytest.mark.parametrize("side", ["left", "right", "top", "bottom"])
def test_partly_hidden_ball(shown, side):
    centre = np.array([0.05, 0.02, 1.2])
    rgb, depth = draw([(centre, RADIUS_M)])
    red = np.argwhere(rgb[..., 0] > 2.0 * rgb[..., 1])
    axis, rising = {"left": (1, 1), "right": (1, -1), "top": (0, 1), "bottom": (0, -1)}[side]
    order = np.sort(red[:, axis])[::rising]
    cut = order[int((1.0 - shown) * len(order))]
    part = [slice(None), slice(None)]
    part[axis] = slice(None, cut) if rising == 1 else slice(cut + 1, None)
    hide(rgb, depth, tuple(part))
    detection = detect_ball(rgb, depth, VGA, RADIUS_M)
    assert detection.visible_fraction == pytest.approx(shown, abs=0.06)
    assert error_mm(detection, centre) < 2.0
    assert detection.quality < shown + 0.06


def test_ball_cut_off_by_the_border():
    for u, least, most in ((0.0, 0.40, 0.62), (8.0, 0.6, 0.95), (639.0, 0.40, 0.62)):
        centre = 1.2 * VGA.rays(u, 240.0)
        detection = detect_ball(*draw([(centre, RADIUS_M)]), VGA, RADIUS_M)
        assert least < detection.visible_fraction < most
        assert error_mm(detection, centre) < 2.0


def test_nothing_below_a_quarter():
    rng = np.random.default_rng(5)
    for _ in range(30):
        centre = rng.uniform(0.8, 1.8) * VGA.rays(rng.uniform(100, 540), rng.uniform(100, 380))
        rgb, depth = draw([(centre, RADIUS_M)])
        v, u = np.nonzero(rgb[..., 0] > 2.0 * rgb[..., 1])
        # A card with a straight edge in any direction leaves 5 to 24 percent.
        angle = rng.uniform(0, 2 * np.pi)
        level = np.quantile(np.cos(angle) * u + np.sin(angle) * v, rng.uniform(0.05, 0.24))
        rows, columns = np.mgrid[:480, :640]
        hide(rgb, depth, np.cos(angle) * columns + np.sin(angle) * rows > level)
        assert detect_ball(rgb, depth, VGA, RADIUS_M) is None


def test_invalid_depth_is_passed_over():
    centre = np.array([0.1, -0.05, 1.0])
    rgb, depth = draw([(centre, RADIUS_M)])
    holes = np.random.default_rng(1).random(depth.shape)
    depth[holes < 0.3] = 0.0
    depth[holes > 0.8] = np.nan
    assert error_mm(detect_ball(rgb, depth, VGA, RADIUS_M), centre) < 0.6
    depth[:] = np.nan
    assert detect_ball(rgb, depth, VGA, RADIUS_M) is None


@pytest.mark.parametrize("shift_m", [-0.4, -0.04, 0.04, 0.4])
def test_depths_of_something_else_do_not_move_the_ball(shift_m):
    centre = np.array([0.1, -0.05, 1.0])
    rgb, depth = draw([(centre, RADIUS_M)])
    depth[np.random.default_rng(1).random(depth.shape) < 0.2] += shift_m
    assert error_mm(detect_ball(rgb, depth, VGA, RADIUS_M), centre) < 0.6


def test_a_ball_far_away_is_found_but_not_by_a_few_pixels_of_depth():
    centre = np.array([0.3, -0.2, 4.5])
    rgb, depth = draw([(centre, RADIUS_M)], wall_m=9.0)
    assert error_mm(detect_ball(rgb, depth, VGA, RADIUS_M), centre) < 10.0
    depth[np.random.default_rng(1).random(depth.shape) < 0.85] = 0.0
    found, (rejection,) = examine(rgb, depth, VGA, RADIUS_M)
    assert found is None
    assert rejection.cause is Cause.NO_DEPTH


def test_millimetres_of_a_real_camera():
    centre = np.array([0.1, -0.05, 1.3])
    rgb, depth = draw([(centre, RADIUS_M)])
    sixteen_bit = np.round(1000.0 * depth).astype(np.uint16)
    detection = detect_ball(rgb, sixteen_bit.astype(np.float32) * 1e-3, VGA, RADIUS_M)
    assert error_mm(detection, centre) < 0.6


def test_highlight_is_part_of_the_ball():
    centre = np.array([0.0, 0.0, 1.0])
    rgb, depth = draw([(centre, RADIUS_M)])
    rgb[232:238, 322:328] = 250
    detection = detect_ball(rgb, depth, VGA, RADIUS_M)
    assert detection.visible_fraction == pytest.approx(1.0, abs=0.02)
    assert error_mm(detection, centre) < 0.6


def test_window_gives_the_same_position():
    centre = np.array([0.2, 0.1, 1.1])
    rgb, depth = draw([(centre, RADIUS_M)])
    whole = detect_ball(rgb, depth, VGA, RADIUS_M)
    u0, v0 = int(whole.pixel[0]) - 60, int(whole.pixel[1]) - 40
    part = np.s_[v0 : v0 + 90, u0 : u0 + 120]
    window = detect_ball(rgb[part], depth[part], VGA.window(u0, v0, 120, 90), RADIUS_M)
    np.testing.assert_allclose(window.position_m, whole.position_m, atol=1e-12)


@pytest.mark.parametrize("other_radius_m", [0.02, 0.028, 0.056, 0.09])
def test_a_ball_of_another_size_is_not_the_ball(other_radius_m):
    for z in (0.7, 1.2, 1.6):
        other = (np.array([0.05, 0.02, z]), other_radius_m)
        assert detect_ball(*draw([other]), VGA, RADIUS_M) is None


@pytest.mark.parametrize("share", [0.95, 1.05])
def test_a_radius_that_is_told_a_little_wrong_still_finds_the_ball(share):
    for z in (0.7, 1.0, 1.3, 1.6):
        centre = np.array([0.05, 0.02, z])
        detection = detect_ball(*draw([(centre, share * RADIUS_M)]), VGA, RADIUS_M)
        assert error_mm(detection, centre) < 4.0


def test_balls_of_nearly_its_size_are_seldom_taken_for_it_though_partly_hidden():
    rng, taken = np.random.default_rng(3), 0
    view = VGA.window(240, 160, 160, 160)
    rows, columns = np.mgrid[:160, :160]
    for _ in range(120):
        z, radius_m = rng.uniform(0.7, 1.5), rng.choice([0.028, 0.033, 0.05, 0.056])
        other = z * VGA.rays(rng.uniform(300, 340), rng.uniform(220, 260)), radius_m
        rgb, depth = draw([other], view)
        angle = rng.uniform(0.0, 2.0 * np.pi)
        across = np.cos(angle) * columns + np.sin(angle) * rows
        shown = np.quantile(across[rgb[..., 0] > 2.0 * rgb[..., 1]], rng.uniform(0.3, 1.0))
        hide(rgb, depth, across > shown, z - 0.1)
        taken += detect_ball(rgb, depth, view, RADIUS_M) is not None
    assert taken < 0.2 * 120


def test_a_ball_is_found_among_many_larger_red_things():
    centre = np.array([0.0, 0.0, 1.2])
    others = [(np.array([x, y, 1.2]), 0.06) for x in (-0.4, -0.2, 0.2, 0.4) for y in (-0.3, 0.3)]
    assert error_mm(detect_ball(*draw([*others, (centre, RADIUS_M)]), VGA, RADIUS_M), centre) < 0.6


def test_a_red_stem_that_the_ball_sits_on_moves_it_little():
    for width in (0.1, 0.3, 0.5):
        centre = np.array([0.02, 0.01, 1.0])
        rgb, depth = draw([(centre, RADIUS_M)])
        u, v = VGA.project(centre)
        radius_px = VGA.fx * RADIUS_M
        stem = np.s_[
            int(v) : int(v + 1.8 * radius_px),
            int(u - width * radius_px) : int(u + width * radius_px),
        ]
        behind = depth[stem] > 1.5
        rgb[stem][behind], depth[stem][behind] = (200, 20, 20), 1.0
        assert error_mm(detect_ball(rgb, depth, VGA, RADIUS_M), centre) < 1.0


def test_ball_before_a_bigger_red_ball():
    centre = np.array([0.02, 0.0, 1.1])
    behind = (np.array([0.05, 0.03, 1.4]), 0.12)
    detection = detect_ball(*draw([(centre, RADIUS_M), behind]), VGA, RADIUS_M)
    assert error_mm(detection, centre) < 3.0


def test_red_flat_things_are_not_the_ball():
    for half in (10, 18, 24, 60, 200):
        rgb, depth = draw([])
        part = np.s_[240 - half : 240 + half, 320 - half : 320 + half]
        rgb[part] = (200, 20, 20)
        depth[part] = 1.2
        assert detect_ball(rgb, depth, VGA, RADIUS_M) is None
    # A disc of exactly the ball's size, but flat.
    rgb, depth = draw([(np.array([0.0, 0.0, 1.2]), RADIUS_M)])
    depth[rgb[..., 0] > 2.0 * rgb[..., 1]] = 1.2
    assert detect_ball(rgb, depth, VGA, RADIUS_M) is None


def test_empty_picture():
    assert detect_ball(*draw([]), VGA, RADIUS_M) is None


@pytest.mark.parametrize("bad", [np.inf, -np.inf, np.nan, -1.0])
def test_depth_that_no_camera_gives_is_no_depth(bad):
    centre = np.array([0.1, -0.05, 1.0])
    rgb, depth = draw([(centre, RADIUS_M)])
    spoiled = np.random.default_rng(1).random(depth.shape) < 0.4
    depth[spoiled] = bad
    assert error_mm(detect_ball(rgb, depth, VGA, RADIUS_M), centre) < 0.6
    depth[:] = bad
    assert detect_ball(rgb, depth, VGA, RADIUS_M) is None


def test_what_is_not_the_ball_is_told_with_the_reason():
    ball, twice = (np.array([0.1, 0.0, 1.2]), RADIUS_M), (np.array([-0.2, 0.0, 1.2]), 2 * RADIUS_M)
    detection, rejections = examine(*draw([ball, twice]), VGA, RADIUS_M)
    assert error_mm(detection, ball[0]) < 0.6
    assert [r.cause for r in rejections] == [Cause.SIZE]
    assert rejections[0].area_ratio == pytest.approx(4.0, rel=0.1)
    assert rejections[0].distance_m == pytest.approx(1.2, abs=0.1)


def test_sizes_must_agree():
    rgb, depth = draw([])
    with pytest.raises(ValueError, match="640x480"):
        detect_ball(rgb[:100], depth, VGA, RADIUS_M)


def test_shade_and_hue_limits():
    reds = np.array([[[200, 20, 20], [60, 6, 6], [220, 20, 60], [240, 130, 30], [200, 200, 200]]])
    mask = colour_mask(reds.astype(np.uint8), BallColour())
    assert (mask[0] > 0).tolist() == [True, True, True, False, False]
    green = BallColour(hue=60)
    assert colour_mask(np.array([[[10, 200, 10]]], np.uint8), green).all()
    with pytest.raises(ValueError, match="hue"):
        BallColour(hue=200)


# ---------------------------------------------------------------- drawn by the simulator
def errors_over_poses(count, noise, seed, camera="front"):
    """(visible fraction, error in mm) over random poses in the box."""
    rng = np.random.default_rng(seed)
    pose = camera_preset(camera)
    results = []
    with_world = World()
    renderer = Renderer(with_world.client, VGA)
    for _ in range(count):
        with_world.reset(CENTRE + HALF_BOX * rng.uniform(-1.0, 1.0, 6))
        with_world.place_ball()
        truth = pose.to_camera(with_world.ball_position())
        # The part of the image around the ball, for speed.
        u0, v0 = np.clip(VGA.project(truth) - 80, 0, [480, 320]).astype(int).tolist()
        rgb, depth = renderer.render(pose, Region(u0, v0, 160, 160))
        depth = add_depth_noise(depth, VGA.fx, rng, noise)
        detection = detect_ball(rgb, depth, VGA.window(u0, v0, 160, 160), RADIUS_M)
        if detection is not None:
            results.append((detection.visible_fraction, error_mm(detection, truth)))
    with_world.close()
    return np.array(results)


@pytest.mark.parametrize(("noise", "full_mm", "part_mm"), [(0.0, 0.7, 1.0), (1.0, 1.5, 3.0)])
def test_accuracy_over_random_poses(noise, full_mm, part_mm):
    results = errors_over_poses(75, noise, seed=11)
    assert len(results) >= 73
    full = results[:, 0] > 0.97
    assert np.sqrt(np.mean(np.square(results[full, 1]))) < full_mm
    assert np.sqrt(np.mean(np.square(results[~full, 1]))) < part_mm
    assert results[:, 1].max() < 10.0


RED = (0.86, 0.07, 0.06, 1.0)


def distractors(rng):
    """A cube, a bigger ball behind, a smaller ball and a plate, all red, around the work area."""

    def place(x, y, z):
        return tuple(np.array([x, y, z]) + rng.uniform(-0.12, 0.12, 3))

    return (
        SceneObject("box", place(-0.6, 0.35, 0.15), (0.06, 0.06, 0.06), RED),
        SceneObject("sphere", place(-0.2, -0.5, 0.45), (0.09,), RED),
        SceneObject("sphere", place(-0.75, -0.3, 0.2), (0.025,), RED),
        SceneObject("box", place(-0.3, -0.6, 0.1), (0.3, 0.02, 0.2), RED),
    )


def test_other_red_things_do_not_win():
    rng = np.random.default_rng(21)
    pose = camera_preset("front")
    found = wanted = 0
    for _ in range(4):
        world = World(objects=TABLE + distractors(rng))
        renderer = Renderer(world.client, VGA)
        for _ in range(8):
            world.reset(CENTRE + HALF_BOX * rng.uniform(-1.0, 1.0, 6))
            world.place_ball()
            rgb, depth = renderer.render(pose)
            detection = detect_ball(rgb, add_depth_noise(depth, VGA.fx, rng), VGA, RADIUS_M)
            wanted += 1
            if detection is not None:
                found += 1
                assert error_mm(detection, pose.to_camera(world.ball_position())) < 15.0
        world.close()
    assert found >= 0.9 * wanted


def test_other_red_things_alone_are_not_the_ball():
    rng = np.random.default_rng(22)
    for _ in range(3):
        moved = tuple(
            SceneObject(o.kind, tuple(np.add(o.position_m, (5.0, 0, 0))), o.size_m, o.rgba)
            for o in distractors(rng)
        )
        world = World(objects=moved)
        renderer = Renderer(world.client, VGA)
        for eye in ((3.4, 1.1, 1.0), (3.3, -0.4, 0.9), (5.0, 1.1, 0.8)):
            pose = pose_from_look_at(eye, (4.5, -0.2, 0.2))
            rgb, depth = renderer.render(pose)
            noisy = add_depth_noise(depth, VGA.fx, rng)
            assert colour_mask(rgb, BallColour()).any()
            assert detect_ball(rgb, noisy, VGA, RADIUS_M) is None
        world.close()
