"""How the camera was moved, learned from where the ball is; and the chain behind that camera."""

import numpy as np
import pytest
from recordings import Recording, random_rotation, relative_error, turn, ur5_chain

from fvs_estimator_node.base import MotionStep
from fvs_estimator_node.camera_motion import CameraMotion, CameraMotionConfig
from fvs_estimator_node.poe import POE_PARAMETERS, PoeEstimator, poe_config
from fvs_estimator_node.rotations import nearest_rotation, rotation_angle_rad

NOISE_M = 0.001


def path(count, rng):
    """A ball that wanders about, 15 mm at a time, m, shape (count, 3)."""
    direction = np.cumsum(rng.normal(size=(count, 3)), axis=0)
    steps = 0.015 * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return np.array([0.0, 0.0, 1.4]) + np.cumsum(steps, axis=0)


def watch(camera, balls, rotation, translation, rng, noise_m=NOISE_M):
    for ball in balls:
        camera.add(ball, rotation @ ball + translation + noise_m * rng.normal(size=3))


def angle_between(one, other):
    return rotation_angle_rad(one.T @ other)


@pytest.mark.parametrize("degrees", [1.0, 20.0, 90.0, 180.0])
def test_any_turn_and_shift_is_found_in_half_a_metre(degrees):
    rng = np.random.default_rng(int(degrees))
    rotation = turn(rng.normal(size=3), np.radians(degrees))
    translation = 0.3 * rng.normal(size=3)
    camera, balls = CameraMotion(), path(40, rng)
    watch(camera, balls, rotation, translation, rng)
    assert angle_between(camera.rotation, rotation) < np.radians(1.5)
    assert camera.doubts.bumps == 1
    np.testing.assert_allclose(
        camera.rotation @ balls[-1] + camera.translation_m,
        rotation @ balls[-1] + translation,
        atol=0.002,
    )


def test_a_camera_that_stands_still_is_not_turned_by_noise():
    rng = np.random.default_rng(0)
    camera, turned = CameraMotion(), []
    for ball in path(500, rng):
        watch(camera, [ball], np.eye(3), np.zeros(3), rng)
        turned.append(camera.angle_rad)
    assert max(turned) < np.radians(1.5)
    assert turned[-1] < np.radians(0.1)
    assert camera.doubts.bumps == 0
    assert camera.noise_m == pytest.approx(NOISE_M, rel=0.3)


@pytest.mark.parametrize("seed", range(5))
def test_noise_beyond_the_first_guess_is_learned_and_no_bump(seed):
    rng, camera = np.random.default_rng(seed), CameraMotion()
    balls = path(300, rng)
    watch(camera, balls[:60], np.eye(3), np.zeros(3), rng, 0.006)
    assert camera.noise_m == pytest.approx(0.006, rel=0.3)
    before = camera.doubts.bumps
    watch(camera, balls[60:], np.eye(3), np.zeros(3), rng, 0.006)
    assert camera.doubts.bumps == before


def test_an_arm_that_hardly_moves_does_not_make_it_forget():
    rng = np.random.default_rng(0)
    rotation = turn([1.0, 2.0, 3.0], 0.5)
    camera = CameraMotion(CameraMotionConfig(memory=30.0))
    watch(camera, path(60, rng), rotation, np.zeros(3), rng)
    learned = angle_between(camera.rotation, rotation)
    to_and_fro = np.array([0.1, 0.0, 1.4]) + np.outer(np.sin(np.arange(3000.0)), [0.03, 0, 0])
    watch(camera, to_and_fro, rotation, np.zeros(3), rng)
    assert angle_between(camera.rotation, rotation) < learned + np.radians(6.0)


@pytest.mark.parametrize("in_a_row", [1, 2, 5])
def test_outliers_fool_nobody(in_a_row):
    rng = np.random.default_rng(in_a_row)
    camera = CameraMotion()
    for i, ball in enumerate(path(400, rng)):
        off = 0.2 * rng.normal(size=3) if i % 40 < in_a_row else np.zeros(3)
        camera.add(ball, ball + off + NOISE_M * rng.normal(size=3))
    assert camera.doubts.bumps == 0
    assert camera.angle_rad < np.radians(0.6)


def test_a_bump_is_noticed_and_the_new_pose_learned():
    rng = np.random.default_rng(0)
    camera, balls = CameraMotion(), path(200, rng)
    watch(camera, balls[:100], np.eye(3), np.zeros(3), rng)
    rotation, translation = turn([0.0, 1.0, 0.2], 0.4), np.array([0.05, 0.1, 0.0])
    watch(camera, balls[100:103], rotation, translation, rng)
    assert camera.doubts.bumps == 1
    watch(camera, balls[103:], rotation, translation, rng)
    assert camera.doubts.bumps == 1
    assert angle_between(camera.rotation, rotation) < np.radians(1.0)


@pytest.mark.parametrize("degrees", [5.0, 10.0])
def test_how_a_bump_turned_the_camera_is_half_known_within_six_centimetres(degrees):
    off, rotation = [], turn([0.2, 1.0, 0.3], np.radians(degrees))
    for seed in range(8):
        rng, camera = np.random.default_rng(seed), CameraMotion()
        balls = path(60, rng)
        watch(camera, balls, np.eye(3), np.zeros(3), rng, 0.0005)
        watch(camera, corner(balls[-1], 2), rotation, np.zeros(3), rng, 0.0005)
        off.append(angle_between(camera.rotation, rotation))
    assert np.median(off) < np.radians(3.4)


def test_a_camera_that_sags_slowly_is_followed():
    rng = np.random.default_rng(0)
    camera, time_s = CameraMotion(), np.arange(1800) / 30.0
    swing = np.sin(time_s[:, None] * [1.5, 1.1, 0.9] + [0.0, 1.0, 2.0])
    off = []
    for passed_s, ball in zip(time_s, np.array([0.0, 0.0, 1.4]) + 0.25 * swing, strict=True):
        rotation = turn([1.0, 1.0, 0.3], np.radians(0.2 * passed_s))
        watch(camera, [ball], rotation, np.zeros(3), rng)
        off.append(angle_between(camera.rotation, rotation))
    assert max(off) < np.radians(5.0)
    assert np.median(off) < np.radians(2.0)
    assert camera.noise_m == pytest.approx(NOISE_M, rel=0.3)


def carry(camera, balls, degrees, rng, about=None):
    """Carry it evenly while it watches, by 10 cm or about a point; returns the last pose."""
    axis = np.array([0.2, 1.0, 0.3]) / np.linalg.norm([0.2, 1.0, 0.3])
    for done, ball in zip(np.linspace(0.0, 1.0, len(balls)), balls, strict=True):
        rotation = turn(axis, np.radians(degrees) * done)
        shift = np.array([0.1, 0.0, 0.0]) * done if about is None else about - rotation @ about
        watch(camera, [ball], rotation, shift, rng)
    return rotation, shift


def resting(ball, count, rng):
    """A ball at rest, but for a fifth of a millimetre."""
    return ball + 0.0002 * rng.normal(size=(count, 3))


def corner(ball, legs=6):
    """A ball that goes some steps of 15 mm along one line, and then along another."""
    along = np.repeat(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), legs, axis=0)
    return ball + 0.015 * np.cumsum(along, axis=0)


@pytest.mark.parametrize("degrees", [20.0, 30.0, 45.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_camera_that_is_carried_while_the_ball_rests_is_known_after_a_short_way(degrees, seed):
    rng = np.random.default_rng(seed)
    camera, balls = CameraMotion(), path(100, rng)
    watch(camera, balls[:100], np.eye(3), np.zeros(3), rng)
    rotation, translation = carry(camera, resting(balls[99], 60, rng), degrees, rng)
    watch(camera, resting(balls[99], 30, rng), rotation, translation, rng)
    assert camera.angle_rad < np.radians(2.0)  # a ball at rest tells nothing of it
    watch(camera, corner(balls[99]), rotation, translation, rng)
    assert angle_between(camera.rotation, rotation) < np.radians(8.0)


@pytest.mark.parametrize("seed", range(3))
def test_a_camera_that_is_carried_while_the_ball_moves_is_known_soon_after(seed):
    rng = np.random.default_rng(seed)
    camera, balls = CameraMotion(), path(200, rng)
    watch(camera, balls[:100], np.eye(3), np.zeros(3), rng)
    rotation, translation = carry(camera, balls[100:160], 45.0, rng)
    watch(camera, corner(balls[159]), rotation, translation, rng)
    assert angle_between(camera.rotation, rotation) < np.radians(8.0)


@pytest.mark.parametrize("degrees", [60.0, 120.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_turn_about_the_ball_is_seen_by_the_way_it_goes_next(degrees, seed):
    rng = np.random.default_rng(seed)
    camera, balls = CameraMotion(), path(100, rng)
    watch(camera, balls[:100], np.eye(3), np.zeros(3), rng)
    rotation, translation = carry(
        camera, resting(balls[99], 60, rng), degrees, rng, about=balls[99]
    )
    assert camera.doubts.bumps == 0
    watch(camera, corner(balls[99]), rotation, translation, rng)
    assert camera.doubts.bumps <= 2
    assert angle_between(camera.rotation, rotation) < np.radians(10.0)


@pytest.mark.parametrize("noise_m", [0.0002, 0.001, 0.004])
def test_after_a_small_bump_noise_does_not_turn_it(noise_m):
    rng = np.random.default_rng(0)
    camera, balls = CameraMotion(), path(100, rng)
    watch(camera, balls, np.eye(3), np.zeros(3), rng, noise_m)
    rotation, translation = turn([0.0, 1.0, 0.2], np.radians(5.0)), np.array([0.1, 0.0, 0.0])
    rest = resting(balls[-1], 150, rng)
    off = []
    for ball in rest:
        watch(camera, [ball], rotation, translation, rng, noise_m)
        off.append(angle_between(camera.rotation, rotation))
    assert camera.doubts.bumps == 1
    assert max(off) < np.radians(6.5)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e6, 1e200])
def test_what_is_not_finite_or_beyond_reason_teaches_nothing(bad):
    rng = np.random.default_rng(0)
    camera, balls = CameraMotion(), path(30, rng)
    watch(camera, balls, np.eye(3), np.zeros(3), rng)
    before = camera.rotation.copy(), camera.translation_m.copy(), camera.noise_m
    with np.errstate(all="ignore"):
        for _ in range(10):
            assert not camera.add(balls[-1], np.array([0.0, bad, 1.0]))
            assert not camera.add(np.array([np.nan, 0.0, 1.0]), balls[-1])
    np.testing.assert_array_equal(camera.rotation, before[0])
    np.testing.assert_array_equal(camera.translation_m, before[1])
    assert (camera.noise_m, camera.doubts.bumps) == (before[2], 0)


def test_the_nearest_rotation_is_a_rotation_and_that_of_a_rotation_itself():
    rng = np.random.default_rng(0)
    for _ in range(50):
        found = nearest_rotation(rng.normal(size=(3, 3)))
        np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(found) > 0.0
        rotation = random_rotation(rng)
        np.testing.assert_allclose(nearest_rotation(3.0 * rotation), rotation, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "value"),
    [("rotation_deviation_rad", 0.0), ("bump_m", np.nan), ("memory", 0.5), ("bump_repeats", 0)],
)
def test_a_wrong_setting_is_refused_with_its_name(name, value):
    with pytest.raises(ValueError, match=f"{name} must be .*{value}"):
        CameraMotionConfig(**{name: value})


# --- the estimator ---


def watch_chain(estimator, chain, joints, rng):
    """Let it see a ball on a chain at joints, rad, shape (n, 6)."""
    balls = chain.position(joints) + NOISE_M * rng.normal(size=(len(joints), 3))
    for one, ball in zip(joints, balls, strict=True):
        estimator.observe(one, ball)


def test_the_chain_behind_a_turned_camera():
    rng = np.random.default_rng(0)
    fitted = ur5_chain()
    seen = fitted.moved(turn([0.3, 0.1, 1.0], np.radians(45.0)), np.array([0.1, -0.2, 0.1]))
    estimator = PoeEstimator(fitted)
    recording = Recording()
    joints, places = recording.joints(np.arange(60) / 15.0), recording.places()
    np.testing.assert_array_equal(estimator.jacobian(joints[0]), fitted.jacobian(joints[0]))
    watch_chain(estimator, seen, joints, rng)
    learned = np.array([estimator.jacobian(q) for q in places])
    assert np.median(relative_error(learned, seen.jacobian(places))) < 0.01
    np.testing.assert_allclose(estimator.chain.position(places), seen.position(places), atol=0.01)
    np.testing.assert_allclose(estimator.chain.jacobian(places), learned, atol=1e-9)
    values = estimator.status_values()
    assert values["camera_turned_deg"] == pytest.approx(45.0, abs=1.0)
    assert values["camera_bumps"] == 1.0
    assert values["updates"] == estimator.updates > 50
    estimator.reset()
    assert estimator.updates == 0
    np.testing.assert_array_equal(estimator.jacobian(joints[0]), fitted.jacobian(joints[0]))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_an_observation_that_is_not_finite_teaches_nothing(bad):
    estimator = PoeEstimator(ur5_chain())
    joints = Recording().joints(np.zeros(1))[0]
    ball = ur5_chain().position(joints) + 0.001
    estimator.observe(np.full(6, bad), ball)
    estimator.observe(joints, np.full(3, bad))
    estimator.update(MotionStep(1.0, 0.03, joints, np.full(6, 0.01), np.zeros(3)))
    assert estimator.updates == 0
    np.testing.assert_array_equal(estimator.jacobian(joints), ur5_chain().jacobian(joints))


def test_at_rest_a_bump_is_noticed_and_nothing_forgotten():
    rng = np.random.default_rng(0)
    fitted = ur5_chain()
    turned = fitted.moved(turn([0.3, 0.1, 1.0], np.radians(45.0)), np.array([0.1, -0.2, 0.1]))
    estimator = PoeEstimator(fitted)
    joints = Recording().joints(np.arange(60) / 15.0)
    watch_chain(estimator, turned, joints, rng)
    learned = estimator.jacobian(joints[0])
    watch_chain(estimator, turned, np.repeat(joints[-1:], 3000, axis=0), rng)
    np.testing.assert_allclose(estimator.jacobian(joints[0]), learned, atol=0.01)
    watch_chain(estimator, fitted, np.repeat(joints[-1:], 3, axis=0), rng)
    assert estimator.camera.doubts.bumps == 2


def test_every_declared_parameter_reaches_the_configuration():
    assert poe_config({p.name: p.default for p in POE_PARAMETERS}) == CameraMotionConfig()
    assert {p.name for p in POE_PARAMETERS} == {f"poe.{n}" for n in CameraMotionConfig().__dict__}
    assert poe_config({"poe.memory": 5.0, "rbf.mu": 1.0}).memory == 5.0
