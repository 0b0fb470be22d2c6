"""The simulator keeps the real robot's contract and its promises in time."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from cases import each

from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.detectors import make_detector, make_object_detector
from fvs_ros.camera import CameraModel
from fvs_ros.rotations import rotation_from_vector
from fvs_sim_node.actuator import Actuator
from fvs_sim_node.camera import RigidPose
from fvs_sim_node.config import SimConfig
from fvs_sim_node.simulation import Simulation

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


def change(simulation, **changes):
    simulation.configure(replace(simulation.config, **changes))


def run(simulation, periods, velocity=None):
    if velocity is not None:
        assert simulation.command(velocity) is None
    return [simulation.advance() for _ in range(periods)]


def observations(steps):
    return [observation for step in steps for observation in step.observations]


def drive_waves(simulation, periods):
    steps = []
    for k in range(periods):
        simulation.command(0.4 * np.sin(0.02 * k + np.arange(6)))
        steps.append(simulation.advance())
    return steps


def test_time_rates_and_latency(make):
    simulation = make(rendered=False)
    for latency_s in (0.0, 0.04, 0.12):
        change(simulation, latency_s=latency_s)
        simulation.reset()
        steps = run(simulation, 125)
        np.testing.assert_allclose([s.time_s for s in steps], PERIOD_S * np.arange(1, 126))
        stamps = [o.stamp_s for o in observations(steps)]
        # 30 Hz on steps of 2 ms: each exposure at the nearest step.
        np.testing.assert_allclose(stamps, np.arange(len(stamps)) / 30.0, atol=0.001 + 1e-9)
        ages = [step.time_s - seen.stamp_s for step in steps for seen in step.observations]
        assert len(ages) > 25
        assert latency_s - 1e-9 <= min(ages) <= max(ages) < latency_s + PERIOD_S + 1e-9


def assert_white(errors, deviation):
    few = 3.5 / np.sqrt(len(errors))  # chance gets there once in two thousand times
    np.testing.assert_allclose(errors.std(axis=0), deviation, rtol=few / np.sqrt(2.0))
    axes_and_times = np.column_stack([errors[1:], errors[:-1]])
    np.testing.assert_allclose(np.corrcoef(axes_and_times.T), np.eye(2 * errors.shape[1]), atol=few)


def test_noise_of_positions_and_encoders_is_white_and_moves_no_joint(make):
    simulation = make(position_noise_m=0.01, depth_noise=0.0, rendered=False)
    seen = [simulation.look() for _ in range(1000)]
    assert_white(np.array([o.z - o.true_position_m for o in seen]), 0.01)
    noisy, quiet = make(rendered=False, encoder_noise_rad=0.01), make(rendered=False)
    reported = np.array([s.joints_rad for s in drive_waves(noisy, 500)])
    assert_white(reported - [s.joints_rad for s in drive_waves(quiet, 500)], 0.01)
    np.testing.assert_array_equal(noisy.joints_rad, quiet.joints_rad)


def test_a_position_drive_follows_and_refuses_what_is_far_away(make):
    simulation = make(rendered=False, command_interface="position")
    start, travel = simulation.joints_rad, np.array([0.2, -0.1, 0.1, 0.0, 0.3, 0.1])
    run(simulation, 20)
    np.testing.assert_allclose(simulation.joints_rad, start)
    for share in np.linspace(0.0, 1.0, 60):
        assert simulation.command(start + share * travel) is None
        simulation.advance()
    assert np.abs(simulation.joints_rad - start - travel).max() < 0.03
    run(simulation, 100)
    np.testing.assert_allclose(simulation.joints_rad, start + travel, atol=1e-3)
    assert "2.00 rad away" in simulation.command(simulation.joints_rad + 2.0)
    assert "5 values deactivated the position controller" in simulation.command(np.zeros(5))
    run(simulation, 50)
    np.testing.assert_allclose(simulation.joints_rad, start + travel, atol=1e-3)


def test_a_servo_has_play_stops_short_and_reports_whole_steps(make):
    play, short, step = 0.02, 0.01, 2.0 * np.pi / 4096
    simulation = make(
        rendered=False,
        robot="so101",
        command_interface="position",
        backlash_rad=play,
        stops_short_rad=short,
        encoder_steps=4096,
    )
    start = simulation.joints_rad
    for goal, motor in ((0.2, 0.2 - short), (0.195, 0.2 - short), (0.15, 0.15 + short)):
        for _ in range(250):
            assert simulation.command(start + goal) is None
            out = simulation.advance()
        back = play if goal == 0.15 else 0.0
        np.testing.assert_allclose(out.joints_rad - start, motor, atol=step)
        np.testing.assert_allclose(
            simulation.joints_rad - start, motor - 0.5 * play + back, atol=step
        )
        np.testing.assert_allclose(out.joints_rad / step, np.round(out.joints_rad / step))


@each("rendered", [True, False])
def test_a_ball_out_of_view_or_behind_a_hand_is_lost_and_found_again(make, rendered):
    simulation = make(rendered=rendered)
    for lost in (
        {"camera_rotation_deg": (0.0, 40.0, 0.0)},
        {"camera_rotation_deg": (0.0, 180.0, 0.0)},
        {"camera_covered": True},
    ):
        assert simulation.look().z is not None
        before = simulation.config
        change(simulation, **lost)
        assert simulation.look().z is None
        simulation.configure(before)


def test_images_and_camera_info_have_the_cameras_errors(make):
    def depths_m(**errors):
        simulation = make(depth_noise=0.0, **errors)
        simulation.full_frames = True
        return simulation.look().frame[1], simulation.reported_intrinsics.fx

    (true_m, fx), (wrong_m, wrong_fx) = depths_m(), depths_m(depth_error=0.02, focal_error=-0.01)
    np.testing.assert_allclose(wrong_m, 1.02 * true_m, rtol=1e-6)
    assert wrong_fx == pytest.approx(0.99 * fx)


def test_another_camera_moves_no_arm_that_has_no_named_poses(make):
    simulation = make(robot="scara", rendered=False)
    run(simulation, 25, [0.3, -0.2, 0.0, 0.4])
    before, _ = simulation.world.joint_states()
    change(simulation, camera="overhead")
    np.testing.assert_array_equal(simulation.world.joint_states()[0], before)


# ---- drives ---------------------------------------------------------------------------------


DT_S = 0.002
WIDE = np.full(6, 100.0)


def drives(lower=-WIDE, upper=WIDE, **constants):
    return Actuator(SimConfig(**constants), lower, upper, np.full(6, np.pi))


def driven(actuator, steps, command=None, positions=None):
    """Velocities over time, (steps, 6), with the positions integrated along."""
    positions = np.zeros(6) if positions is None else positions
    if command is not None:
        actuator.command(np.broadcast_to(command, 6))
    velocities = []
    for _ in range(steps):
        velocities.append(actuator.step(positions))
        positions += DT_S * velocities[-1]
    return np.array(velocities)


def test_dead_time_then_ramp_then_command_for_ever():
    velocity = driven(drives(lag_s=0.0), 5000, 0.3)[:, 0]
    assert not velocity[:4].any()
    np.testing.assert_allclose(velocity[4:14], 15.0 * DT_S * np.arange(1, 11))
    np.testing.assert_allclose(velocity[14:], 0.3)
    fastest = driven(drives(), 500, 50.0)[-1]
    np.testing.assert_allclose(fastest, np.pi, atol=1e-6)


@each(("lag_s", "joint_lag_s"), [(0.1, 0.0), (0.0, 0.1)])
def test_lag_is_first_order(lag_s, joint_lag_s):
    quick = {"dead_time_s": 0.0, "acceleration_limit_rad_s2": 1000.0}
    velocity = driven(drives(lag_s=lag_s, joint_lag_s=joint_lag_s, **quick), 30, 1.0)[:, 2]
    time_s = DT_S * np.arange(1, 31)
    np.testing.assert_allclose(velocity, 1.0 - np.exp(-time_s / 0.1), atol=1e-12)


@each("joint_lag_s", [0.0, 0.05])
@each("sign", [1.0, -1.0])
def test_joint_stops_at_its_limit_and_leaves_it_as_from_rest(sign, joint_lag_s):
    end = WIDE.copy()
    end[1] = 0.1
    actuator = drives(lower=-end, upper=end, joint_lag_s=joint_lag_s)
    resting, positions = drives(joint_lag_s=joint_lag_s), np.zeros(6)
    velocities = driven(actuator, 400, 0.5 * sign, positions)
    assert positions[1] == pytest.approx(0.1 * sign, abs=1e-9)
    assert velocities[-1, 1] == 0.0
    assert sign * positions[0] > 0.3
    left = driven(actuator, 50, -0.5 * sign, positions)
    np.testing.assert_allclose(left[:, 1], driven(resting, 50, -0.5 * sign)[:, 1], atol=1e-12)


def feature_of(simulation, observation):
    camera = observation.camera.pose_to_own(observation.object_pose)
    return simulation.kind.of_body(camera.position_m, camera.rotation)


@each("feature", ["ball", "pose"])
def test_belt_and_turntable_move_the_object_and_it_is_seen(make, feature):
    moving = {"object_velocity_m_s": (0.1, -0.05, 0.02), "object_turn_rate_deg_s": 30.0}
    simulation = make(feature=feature, object_tag_id=10, rendered=False, **moving)
    kind = simulation.kind
    steps = [simulation.true_object() for _ in range(50) if simulation.advance()]
    motions_m = np.array([kind.minus(b, a) for a, b in pairwise(steps)])
    to_camera = simulation.camera.rotation.T
    twist = to_camera @ moving["object_velocity_m_s"], np.radians(30.0) * to_camera[:, 2]
    expected_m = PERIOD_S * np.concatenate([twist[0], 0.3 * twist[1]])[: kind.size]
    np.testing.assert_allclose(motions_m, np.tile(expected_m, (49, 1)), atol=1e-9)
    change(simulation, object_velocity_m_s=(0.0,) * 3, object_turn_rate_deg_s=0.0)
    stopped = simulation.true_object()
    seen = observations(run(simulation, 25))
    np.testing.assert_allclose(simulation.true_object(), stopped)
    for look in seen:
        np.testing.assert_allclose(look.object_z, feature_of(simulation, look), atol=1e-12)
    simulation.place_object()
    assert np.linalg.norm(kind.minus(simulation.true_object(), steps[0])[:3]) < 1e-3


@each("feature", ["ball", "pose"])
def test_tool_and_object_are_found_in_one_image(make, feature):
    simulation = make(feature=feature, object_tag_id=10)
    simulation.full_frames, kind = True, simulation.kind
    look, true = simulation.look(), (simulation.true_feature(), simulation.true_object())
    config = DetectorConfig(feature=feature, object_tag_id=10)
    for detector, measured, z in zip(
        (make_detector(config), make_object_detector(config)),
        (look.z, look.object_z),
        true,
        strict=True,
    ):
        seen = detector.detect(0.0, *look.frame, CameraModel(simulation.views[0].lens)).detection
        assert np.linalg.norm(kind.minus(measured, z)) < 5e-3
        assert np.linalg.norm(kind.minus(kind.of_body(seen.position_m, seen.rotation), z)) < 5e-3


@each("rendered", [True, False])
def test_an_object_behind_the_tool_is_hidden_in_rendered_images_alone(make, rendered):
    simulation = make(feature="pose", object_tag_id=10, rendered=rendered)
    joints_rad = simulation.world.home_rad
    joints_rad[0] = -0.6
    simulation.reset(joints_rad)
    look = simulation.look()
    assert (look.object_z is None) is rendered
    assert look.z is not None
    change(simulation, object_position_m=(0.45, -2.0, 0.05))
    simulation.place_object()
    assert simulation.look().object_z is None  # out of view


def test_an_object_with_the_tools_tag_is_refused():
    with pytest.raises(ValueError, match="object_tag_id: tag 0 is on the tool"):
        Simulation(SimConfig(feature="pose", object_tag_id=0))


# ---- the camera on the arm ------------------------------------------------------------------


def place_before_camera(simulation, position_m, rotation_rad=(0.0, 0.0, 0.0)):
    """Put what is servoed somewhere in the camera's frame; a tag turned from facing it."""
    facing = np.diag([1.0, -1.0, -1.0]) @ rotation_from_vector(np.array(rotation_rad))
    body = RigidPose(np.array(position_m), facing)
    simulation.world.object_pose = simulation.camera.pose_from_own(body)


@each("feature", ["ball", "pose"])
@each("robot", ["ur5", "scara", "iiwa"])
def test_truth_and_image_of_a_camera_on_the_arm_agree(make, robot, feature):
    simulation = make(robot=robot, feature=feature, camera_mount="arm")
    kind, home_rad = simulation.kind, simulation.world.home_rad
    assert np.linalg.norm(simulation.true_feature()[:3]) == pytest.approx(0.35)
    step, identity = 1e-3, np.eye(len(home_rad))
    simulation.camera = simulation.camera.rotated(np.array([0.05, 0.05, 0.2])).moved(0.01)
    for joints_rad in home_rad + 0.05 * np.array([0.0, 1.0])[:, None] * np.sin(
        np.arange(len(identity))
    ):

        def seen(joints):
            simulation.reset(joints)
            return simulation.true_feature()

        chain, jacobian = simulation.true_chain(), simulation.true_jacobian(joints_rad)
        columns = [
            kind.minus(seen(joints_rad + step * e), seen(joints_rad - step * e)) / (2.0 * step)
            for e in identity
        ]
        np.testing.assert_allclose(jacobian, np.transpose(columns), atol=2e-4)
        np.testing.assert_allclose(chain.position(joints_rad), seen(joints_rad), atol=1e-6)
        assert np.linalg.norm(kind.minus(simulation.look().z, simulation.true_feature())) < 5e-3


@each("rendered", [True, False])
@each(
    ("feature", "position_m", "rotation_rad", "seen"),
    [
        ("pose", (0.0, 0.0, 0.3), (0.0, 0.0, 0.5), True),
        ("pose", (0.08, 0.0, 0.3), (0.0, 1.0, 0.0), True),
        ("pose", (0.15, 0.0, 0.3), (0.0, 0.0, 0.0), False),  # a corner is outside
        ("pose", (0.0, 0.0, 0.3), (0.0, 1.5, 0.0), False),  # too flat
        ("pose", (0.0, 0.0, 0.3), (0.0, 3.0, 0.0), False),  # from behind
        ("pose", (0.0, 0.0, 0.09), (0.0, 0.0, 0.0), False),  # too near
        ("pose", (0.0, 0.0, 6.0), (0.0, 0.0, 0.0), False),  # too far away
        ("ball", (0.0, 0.0, 0.3), (0.0, 0.0, 0.0), True),
        ("ball", (0.0, 0.0, 0.15), (0.0, 0.0, 0.0), False),
        ("ball", (0.3, 0.0, 0.3), (0.0, 0.0, 0.0), False),
    ],
)
def test_a_camera_on_the_arm_sees_what_is_in_view(
    make, rendered, feature, position_m, rotation_rad, seen
):
    simulation = make(feature=feature, camera_mount="arm", rendered=rendered)
    place_before_camera(simulation, position_m, rotation_rad)
    assert (simulation.look().z is not None) is seen


def test_a_tag_is_blurred_by_its_motion_past_the_camera_alone(make):
    simulation = make(feature="pose", camera_mount="arm", depth_noise=0.0)

    def image(arm_rad_s, object_rad_s):
        x, y, _ = object_rad_s * simulation.world.object_pose.position_m
        change(
            simulation,
            object_velocity_m_s=(-y, x, 0.0),
            object_turn_rate_deg_s=np.degrees(object_rad_s),
        )
        velocities = np.eye(6)[0] * arm_rad_s  # about the vertical, as the turntable
        args = simulation.camera, velocities, np.random.default_rng(0)
        return simulation.world.photograph(simulation.config, *args)[0].astype(float)

    still = image(0.0, 0.0)
    assert np.abs(image(1.5, 1.5) - still).max() <= 1.0
    for speeds in ((1.5, 0.0), (0.0, -1.5)):
        assert np.abs(image(*speeds) - still).max() > 30.0
    np.testing.assert_allclose(image(1.5, 0.0), image(0.0, -1.5), atol=1.0)


def test_a_bumped_bracket_stays_bumped_while_the_arm_moves(make):
    simulation = make(camera_mount="arm", rendered=False, camera_rotation_deg=(0.0, 0.0, 90.0))
    x, y, z = simulation.true_feature()
    simulation.camera = simulation.camera.moved(simulation.camera.rotation @ [0.0, 0.02, 0.0])
    np.testing.assert_allclose(simulation.true_feature(), [x, y - 0.02, z], atol=1e-12)
    mounted = simulation.views[0].mounted
    run(simulation, 25, [0.3, -0.2, 0.1, 0.4, 0.0, 0.2])
    assert simulation.views[0].mounted is mounted


def test_the_objects_tags_are_what_a_camera_on_the_arm_sees(make):
    simulation = make(feature="pose", camera_mount="arm", object_tag_id=10, rendered=True)
    assert {*simulation.config.tag.faces} == {10, 11, 12, 13}
    look = simulation.look()
    assert look.object_z is None
    assert np.linalg.norm(simulation.kind.minus(look.z, simulation.true_feature())) < 5e-3


def test_without_depth_a_drawn_balls_size_tells_its_distance_to_a_thousandth(make):
    simulation, errors_m, rng = make(use_depth=False), [], np.random.default_rng(0)
    detector = make_detector(DetectorConfig(use_depth=False))
    home_rad = simulation.joints_rad
    for _ in range(15):
        simulation.reset(home_rad + rng.uniform(-0.3, 0.3, 6))
        seen = simulation.look()
        if seen.visible_fraction > 0.97:
            errors_m.append(np.linalg.norm(seen.z - seen.true_position_m))
    simulation.full_frames = True
    images, camera = simulation.look().frame, CameraModel(simulation.reported_intrinsics)
    in_whole = detector.detect(0.0, *images, camera).detection.position_m
    assert len(errors_m) > 8
    assert np.sqrt(np.mean(np.square(errors_m))) < 0.001
    assert np.linalg.norm(in_whole - simulation.true_feature()) < 0.002
