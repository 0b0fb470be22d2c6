"""The simulator keeps the real robot's contract, its promises in time, and its determinism."""

from dataclasses import replace

import numpy as np
import pytest

from fvs_detector_node.tracking import WindowTracker
from fvs_ros.camera import Intrinsics
from fvs_ros.params import ParameterSet
from fvs_sim_node import kinematics
from fvs_sim_node.config import PARAMETERS
from fvs_sim_node.rendering import CameraPose
from fvs_sim_node.simulation import SimConfig, Simulation
from fvs_sim_node.ur5_urdf import urdf_text

PERIOD_S = 0.008


@pytest.fixture
def make():
    opened = []

    def build(**changes):
        opened.append(Simulation(replace(SimConfig(), **changes)))
        return opened[-1]

    yield build
    for simulation in opened:
        simulation.close()


def run(simulation, periods, velocity=None):
    if velocity is not None:
        assert simulation.command(velocity) is None
    return [simulation.advance() for _ in range(periods)]


def observations(steps):
    return [observation for step in steps for observation in step.observations]


def wave(k):
    return 0.4 * np.sin(0.02 * k + np.arange(6))


def drive_waves(simulation, periods):
    steps = []
    for k in range(periods):
        simulation.command(wave(k))
        steps.append(simulation.advance())
    return steps


# -------------------------------------------------------------------------- time
def test_time_and_rates(make):
    steps = run(make(), 125)
    np.testing.assert_allclose([s.time_s for s in steps], PERIOD_S * np.arange(1, 126))
    stamps = [o.stamp_s for o in observations(steps)]
    # 30 Hz on steps of 2 ms: each exposure at the nearest step.
    np.testing.assert_allclose(stamps, np.arange(len(stamps)) / 30.0, atol=0.001 + 1e-9)
    assert len(stamps) == 29


def test_an_observation_is_released_after_its_latency(make):
    for latency_s in (0.0, 0.04, 0.12):
        for step in run(make(latency_s=latency_s), 60):
            for observation in step.observations:
                age = step.time_s - observation.stamp_s
                assert latency_s - 1e-9 <= age < latency_s + PERIOD_S + 1e-9


def test_latency_is_live(make):
    simulation = make()
    run(simulation, 50)
    simulation.latency_s = 0.1
    run(simulation, 20)
    for step in run(simulation, 50):
        for observation in step.observations:
            assert step.time_s - observation.stamp_s >= 0.1 - 1e-9


def test_image_rate_is_live_from_a_reset_on(make):
    simulation = make(rendered=False)
    simulation.image_rate_hz = 10.0
    simulation.reset()
    stamps = [o.stamp_s for o in observations(run(simulation, 125))]
    np.testing.assert_allclose(stamps, 0.1 * np.arange(10), atol=0.001 + 1e-9)


def test_rates_that_do_not_divide_are_refused():
    with pytest.raises(ValueError, match="whole multiple"):
        SimConfig(physics_rate_hz=500.0, joint_state_rate_hz=120.0)
    with pytest.raises(ValueError, match="image_rate_hz"):
        SimConfig(image_rate_hz=0.0)
    with pytest.raises(ValueError, match="initial_joints_rad"):
        SimConfig(initial_joints_rad=(0.0,))


# ---------------------------------------------------------------------- commands
def test_joints_follow_the_command(make):
    simulation = make()
    velocity = np.array([0.1, -0.2, 0.3, -0.1, 0.2, 0.4])
    steps = run(simulation, 100, velocity)
    np.testing.assert_allclose(steps[-1].joint_velocities_rad_s, velocity, atol=1e-3)
    start = simulation.config.initial_joints_rad
    assert np.all(np.sign(steps[-1].joints_rad - start) == np.sign(velocity))
    difference = (steps[-1].joints_rad - steps[-2].joints_rad) / PERIOD_S
    np.testing.assert_allclose(difference, velocity, atol=2e-3)


def test_a_command_holds_for_ever_and_zeros_stop(make):
    simulation = make(image_rate_hz=1.0)
    run(simulation, 1, np.full(6, 0.1))
    np.testing.assert_allclose(run(simulation, 400)[-1].joint_velocities_rad_s, 0.1, atol=1e-3)
    stopped = run(simulation, 100, np.zeros(6))[-1]
    np.testing.assert_allclose(stopped.joint_velocities_rad_s, 0.0, atol=1e-4)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_command_that_is_not_finite_is_dropped_whole(make, bad):
    simulation = make()
    run(simulation, 50, np.full(6, 0.2))
    assert "not finite" in simulation.command([0.0, 0.0, bad, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(run(simulation, 50)[-1].joint_velocities_rad_s, 0.2, atol=1e-3)
    assert simulation.active


def test_an_empty_command_is_ignored(make):
    simulation = make()
    run(simulation, 50, np.full(6, 0.2))
    assert "empty" in simulation.command([])
    np.testing.assert_allclose(run(simulation, 50)[-1].joint_velocities_rad_s, 0.2, atol=1e-3)


def test_a_wrong_size_deactivates_until_activated(make):
    simulation = make()
    run(simulation, 50, np.full(6, 0.2))
    assert "5 values" in simulation.command(np.zeros(5))
    assert not simulation.active
    assert "inactive" in simulation.command(np.full(6, 0.2))
    np.testing.assert_allclose(run(simulation, 80)[-1].joint_velocities_rad_s, 0.0, atol=1e-4)
    simulation.activate()
    np.testing.assert_allclose(run(simulation, 20)[-1].joint_velocities_rad_s, 0.0, atol=1e-4)
    run(simulation, 80, np.full(6, 0.1))
    assert simulation.active
    np.testing.assert_allclose(run(simulation, 1)[-1].joint_velocities_rad_s, 0.1, atol=1e-3)


def test_speed_scaling_and_joint_lag_are_live(make):
    simulation = make()
    simulation.speed_scaling = 0.5
    last = run(simulation, 80, np.full(6, 0.2))[-1]
    np.testing.assert_allclose(last.joint_velocities_rad_s, 0.1, atol=1e-3)
    simulation.speed_scaling = 1.0
    simulation.joint_lag_s = 0.2
    soon = run(simulation, 5)[-1]
    assert np.all(soon.joint_velocities_rad_s < 0.15)
    with pytest.raises(ValueError, match="0 to 1"):
        simulation.speed_scaling = 40.0
    with pytest.raises(ValueError, match="negative"):
        simulation.joint_lag_s = -1.0


@pytest.mark.parametrize("dead_time_s", [0.0, 0.024, 0.1])
def test_dead_time_is_live_and_nothing_moves_before_it(make, dead_time_s):
    simulation = make(image_rate_hz=1.0)
    simulation.dead_time_s = dead_time_s
    steps = run(simulation, 30, np.full(6, 0.3))
    began_s = next(s.time_s for s in steps if np.all(s.joint_velocities_rad_s > 1e-3))
    assert dead_time_s < began_s <= dead_time_s + 2.0 * PERIOD_S + 1e-9


@pytest.mark.parametrize(
    "slower",
    [
        {"dead_time_s": 0.06},
        {"lag_s": 0.1},
        {"acceleration_limit_rad_s2": 2.0},
        {"joint_lag_s": 0.1},
    ],
)
def test_each_constant_of_the_drives_is_that_of_the_configuration(make, slower):
    usual, changed = (run(make(**one), 6, np.full(6, 0.3))[-1] for one in ({}, slower))
    assert np.all(changed.joint_velocities_rad_s < 0.6 * usual.joint_velocities_rad_s)


# ---------------------------------------------------------------------- the ball
def test_the_ball_comes_from_the_image(make):
    simulation = make()
    seen = observations(drive_waves(simulation, 250))
    errors = [np.linalg.norm(o.detection.position_m - o.true_position_m) for o in seen]
    assert 0.0 < np.sqrt(np.mean(np.square(errors))) < 1.5e-3
    # A grey ball has a position, but is not seen.
    import pybullet

    pybullet.changeVisualShape(
        simulation.world._ball,
        -1,
        rgbaColor=(0.5, 0.5, 0.5, 1.0),
        physicsClientId=simulation.world.client,
    )
    unseen = observations(run(simulation, 40))[3:]
    assert len(unseen) > 3
    assert all(o.detection is None for o in unseen)


def test_noise_is_live(make):
    simulation = make(depth_noise=0.0)
    quiet = observations(run(simulation, 100))
    assert max(np.linalg.norm(o.detection.position_m - o.true_position_m) for o in quiet) < 1e-3
    positions = np.array([o.detection.position_m for o in quiet])
    assert np.ptp(positions, axis=0).max() < 1e-4
    simulation.depth_noise = 1.0
    run(simulation, 10)
    noisy = np.array([o.detection.position_m for o in observations(run(simulation, 100))])
    assert np.ptp(noisy, axis=0).max() > 3e-4


def assert_white(errors, deviation):
    many = 3.5 / np.sqrt(len(errors))  # chance gets there once in two thousand times
    np.testing.assert_allclose(errors.std(axis=0), deviation, rtol=many / np.sqrt(2.0))
    for both in (errors, np.column_stack([errors[1:], errors[:-1]])):
        apart = np.corrcoef(both.T) - np.eye(both.shape[1])
        assert np.abs(apart).max() < many


@pytest.mark.parametrize(("rendered", "images"), [(True, 100), (False, 1000)])
def test_position_noise_is_white_on_each_axis(make, rendered, images):
    simulation = make(position_noise_m=0.01, depth_noise=0.0, rendered=rendered)
    seen = [simulation.look() for _ in range(images)]
    assert_white(np.array([o.detection.position_m - o.true_position_m for o in seen]), 0.01)


def test_encoder_noise_is_white_on_what_is_told_and_moves_no_joint(make):
    simulation, quiet = make(rendered=False), make(rendered=False)
    simulation.encoder_noise_rad = 0.01
    told = np.array([s.joints_rad for s in drive_waves(simulation, 500)])
    assert_white(told - [s.joints_rad for s in drive_waves(quiet, 500)], 0.01)
    np.testing.assert_array_equal(simulation.joints_rad, quiet.joints_rad)


@pytest.mark.parametrize(("focal", "depth"), [(0.05, 0.0), (-0.05, 0.0), (0.0, 0.05), (0.1, 0.1)])
def test_an_error_of_the_calibration_is_alike_in_an_image_and_without(make, focal, depth):
    drawn, known = make(depth_noise=0.0), make(rendered=False)
    for one in (drawn, known):
        one.focal_error, one.depth_error = focal, depth
        one.reset()
    for by_image, by_truth in zip(
        *(observations(drive_waves(one, 100)) for one in (drawn, known)), strict=True
    ):
        seen_m, true_m = by_image.detection.position_m, by_image.true_position_m
        np.testing.assert_array_equal(by_truth.detection.position_m, known.as_seen(true_m))
        # Of 1.5 m; the ball looks larger or smaller than it is told to be, too.
        np.testing.assert_allclose(seen_m, known.as_seen(true_m), atol=4e-3)


@pytest.mark.parametrize("rendered", [True, False])
@pytest.mark.parametrize("turned_rad", [0.7, np.pi])
def test_a_ball_beside_or_behind_the_camera_is_not_seen(make, rendered, turned_rad):
    simulation = make(rendered=rendered)
    assert simulation.look().detection is not None
    simulation.rotate_camera([0.0, turned_rad, 0.0])
    assert simulation.look().detection is None


def test_dropout_loses_observations(make):
    simulation = make(dropout=0.5, image_rate_hz=60.0)
    count = len(observations(run(simulation, 250)))
    assert 35 < count < 85
    simulation.dropout = 1.0
    run(simulation, 10)
    assert not observations(run(simulation, 50))


def test_a_window_sees_what_the_whole_image_sees(make):
    window, whole = make(depth_noise=0.0), make(depth_noise=0.0)
    whole.full_frames = True
    for number, (by_window, by_whole) in enumerate(
        zip(
            observations(drive_waves(window, 60)), observations(drive_waves(whole, 60)), strict=True
        )
    ):
        # The first is searched for, with all that has the ball's colour in the window.
        np.testing.assert_allclose(
            by_window.detection.position_m,
            by_whole.detection.position_m,
            atol=2e-4 if number else 1e-9,
        )
        assert by_window.frame is None
        frame = by_whole.frame
        assert frame.stamp_s == by_whole.stamp_s
        assert frame.rgb.shape == (480, 640, 3)
        assert frame.rgb.dtype == np.uint8
        assert frame.depth_m.shape == (480, 640)
        assert frame.depth_m.dtype == np.float32


def test_a_lost_ball_is_found_again(make):
    simulation = make()
    run(simulation, 20)
    camera = simulation.camera
    simulation.rotate_camera([0.0, 1.5, 0.0])
    assert all(o.detection is None for o in observations(run(simulation, 40))[3:])
    simulation.camera = camera
    back = observations(run(simulation, 40))[3:]
    assert all(o.detection is not None for o in back)


def test_tracker_follows_and_gives_up(make):
    camera = Intrinsics(640, 480, 615.0, 615.0, 319.5, 239.5)
    tracker = WindowTracker(camera, 0.04)
    assert tracker.region(0.0) is None
    simulation = make()
    detection = observations(run(simulation, 20))[0].detection
    tracker.update(0.0, detection)
    here = tracker.region(0.0)
    assert 48 <= here.width <= 80
    step = np.array([0.02, 0.0, 0.0])
    moved = replace(detection, position_m=detection.position_m + step)
    tracker.update(0.1, moved)
    ahead = tracker.region(0.2)
    pixel = camera.project(moved.position_m + step)
    assert ahead.u0 + ahead.width / 2 == pytest.approx(pixel[0], abs=2.0)
    tracker.update(0.2, None)
    assert tracker.region(0.3) is None


# ------------------------------------------------------------------------- truth
def test_true_jacobian_is_the_motion_of_the_true_ball(make):
    simulation = make(image_rate_hz=1.0)
    simulation.command(np.array([0.3, -0.2, 0.25, 0.2, -0.3, 0.5]))
    run(simulation, 50)
    for _ in range(5):
        before, x_before = simulation.advance(), simulation.true_ball_position()
        after, x_after = simulation.advance(), simulation.true_ball_position()
        middle = 0.5 * (before.joints_rad + after.joints_rad)
        predicted = simulation.true_jacobian(middle) @ (after.joints_rad - before.joints_rad)
        np.testing.assert_allclose(x_after - x_before, predicted, atol=1e-7)


def test_another_urdf_gives_the_same_truth(make, tmp_path):
    path = tmp_path / "own.urdf"
    path.write_text(urdf_text(), encoding="utf-8")
    built_in, other = make(), make(urdf_path=str(path))
    joints = np.linspace(-1.0, 1.0, 6)
    np.testing.assert_allclose(
        other.true_jacobian(joints), built_in.true_jacobian(joints), atol=1e-7
    )
    np.testing.assert_allclose(other.true_ball_position(), built_in.true_ball_position(), atol=1e-7)


# ------------------------------------------------------------------ disturbances
def test_a_bump_rotates_the_view_about_the_camera(make):
    simulation = make(depth_noise=0.0)
    run(simulation, 20)
    before = simulation.true_ball_position()
    centre = simulation.camera.position_m.copy()
    joints = np.array(simulation.config.initial_joints_rad)
    jacobian = simulation.true_jacobian(joints)
    simulation.rotate_camera([0.0, 0.0, np.deg2rad(10.0)])
    np.testing.assert_array_equal(simulation.camera.position_m, centre)
    after = simulation.true_ball_position()
    assert np.linalg.norm(after) == pytest.approx(np.linalg.norm(before))
    c, s = np.cos(np.deg2rad(10.0)), np.sin(np.deg2rad(10.0))
    turned = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(after, turned @ before, atol=1e-12)
    np.testing.assert_allclose(simulation.true_jacobian(joints), turned @ jacobian, atol=1e-12)
    seen = observations(run(simulation, 20))[-1]
    np.testing.assert_allclose(seen.detection.position_m, after, atol=1e-3)


def test_moving_the_camera_shifts_the_ball_and_keeps_the_jacobian(make):
    simulation = make()
    joints = np.array(simulation.config.initial_joints_rad)
    before, jacobian = simulation.true_ball_position(), simulation.true_jacobian(joints)
    shift = np.array([0.05, -0.02, 0.03])
    simulation.move_camera(shift)
    np.testing.assert_allclose(
        simulation.true_ball_position(), before - simulation.camera.rotation.T @ shift
    )
    np.testing.assert_array_equal(simulation.true_jacobian(joints), jacobian)


def test_an_own_camera_pose(make):
    rotation = np.diag([1.0, -1.0, -1.0])
    simulation = make(camera_pose=CameraPose(np.array([-0.5, -0.1, 2.0]), rotation))
    ball = kinematics.ball_position(np.array(simulation.config.initial_joints_rad))
    np.testing.assert_allclose(
        simulation.true_ball_position(), rotation @ (ball - [-0.5, -0.1, 2.0]), atol=1e-6
    )


# ------------------------------------------------------------------- determinism
def trace(simulation):
    steps = drive_waves(simulation, 60)
    joints = np.array([s.joints_rad for s in steps])
    balls = np.array([o.detection.position_m for o in observations(steps)])
    return joints, balls


def test_same_seed_same_bits(make):
    first, second = make(dropout=0.1, seed=7), make(dropout=0.1, seed=7)
    joints, balls = trace(first)
    for again in (trace(second), (first.reset(), trace(first))[1]):
        np.testing.assert_array_equal(joints, again[0])
        np.testing.assert_array_equal(balls, again[1])


def test_another_seed_other_noise(make):
    joints, balls = trace(make(seed=1))
    other_joints, other_balls = trace(make(seed=2))
    np.testing.assert_array_equal(joints, other_joints)
    assert np.any(balls != other_balls)


def test_reset_to_other_joints(make):
    simulation = make()
    joints = np.array([0.2, -1.2, 1.5, -1.6, -1.4, 0.1])
    simulation.reset(joints)
    assert simulation.time_s == 0.0
    np.testing.assert_allclose(simulation.advance().joints_rad, joints, atol=1e-9)
    with pytest.raises(ValueError, match="6 finite"):
        simulation.reset([0.0, np.nan, 0.0, 0.0, 0.0, 0.0])


def test_other_image_sizes(make):
    simulation = make(image_width=320, image_height=240)
    assert simulation.intrinsics.fx == pytest.approx(307.5)
    seen = observations(run(simulation, 60))
    errors = [np.linalg.norm(o.detection.position_m - o.true_position_m) for o in seen]
    assert max(errors) < 6e-3


def test_the_nodes_defaults_are_those_of_the_simulation():
    declared = SimConfig.from_values(ParameterSet(PARAMETERS).values())
    assert declared == SimConfig(focal_px=615.0)
