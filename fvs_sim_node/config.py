"""Parameters of ``fvs_sim_node``, declared once."""

from __future__ import annotations

from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.joints import HOME_JOINTS_RAD, N_JOINTS
from fvs_ros.params import Parameter

ALPHABETICAL, KINEMATIC, SHUFFLED = "alphabetical", "kinematic", "shuffled"

PARAMETERS = (
    Parameter("seed", 0, "seed of all noise: same seed, same run", minimum=0),
    Parameter("gui", False, "open PyBullet's window (needs a display)"),
    Parameter(
        "simulated_time",
        False,
        "publish /clock and run as fast as it goes; whoever answers joint states is waited for; "
        "the other nodes then need use_sim_time",
    ),
    Parameter("urdf_path", "", "another robot's URDF with the six UR joints; empty: own UR5"),
    Parameter("ball_link", "", "its link that carries the ball; empty: tool0, or the last link"),
    Parameter("tf_prefix", "", "put before each joint name, as a UR driver does"),
    Parameter(
        "initial_joints_rad",
        list(HOME_JOINTS_RAD),
        "joints at start and after ~/reset",
        size=N_JOINTS,
        minimum=-6.3,
        maximum=6.3,
    ),
    Parameter("ball_radius_m", 0.04, "radius of the ball", minimum=0.01, maximum=0.2),
    Parameter("ball_offset_m", 0.09, "ball centre beyond the flange", minimum=0.0, maximum=0.5),
    Parameter("physics_rate_hz", 500, "physics steps a second", minimum=100, maximum=2000),
    Parameter(
        "joint_state_rate_hz",
        125,
        "joint states a second (500 on an e-series)",
        minimum=10,
        maximum=1000,
    ),
    Parameter("feature_frame", CAMERA_FRAME, "frame of ball and images"),
    Parameter("camera", "front", "where the camera stands", choices=("front", "overhead")),
    Parameter("image_rate_hz", 30.0, "images a second", minimum=1.0, maximum=120.0),
    Parameter(
        "full_frame_rate_hz",
        30.0,
        "full camera images a second, at most, beside a loop in real time; each takes a core for "
        "tens of milliseconds",
        minimum=0.5,
        maximum=120.0,
        live=True,
    ),
    Parameter("image_width", 640, "image width, pixels", minimum=64, maximum=1920),
    Parameter("image_height", 480, "image height, pixels", minimum=48, maximum=1080),
    Parameter("focal_length_px", 615.0, "focal length, pixels", minimum=50.0, maximum=3000.0),
    Parameter(
        "publish_ball_position",
        True,
        "false: images only, for a detector to find the ball in",
    ),
    Parameter(
        "depth_encoding",
        "16UC1",
        "depth images in millimetres or in metres",
        choices=("16UC1", "32FC1"),
    ),
    Parameter("dead_time_s", 0.008, "delay from command to motion", minimum=0.0, maximum=0.5),
    Parameter(
        "acceleration_limit_rad_s2",
        15.0,
        "acceleration limit of the drives",
        minimum=0.1,
        maximum=100.0,
    ),
    Parameter("drive_lag_s", 0.012, "time constant of the drives", minimum=0.0, maximum=0.5),
    # Disturbances, live.
    Parameter(
        "latency_s",
        0.04,
        "time from exposure to the ball position's publication",
        minimum=0.0,
        maximum=1.0,
        live=True,
    ),
    Parameter(
        "depth_noise",
        1.0,
        "scale of the depth camera's noise; 0: none, 1: like a D435",
        minimum=0.0,
        maximum=10.0,
        live=True,
    ),
    Parameter(
        "position_noise_m",
        0.0,
        "further white noise on each coordinate of a ball position (standard deviation), m",
        minimum=0.0,
        maximum=0.1,
    ),
    Parameter("dropout", 0.0, "share of images that are lost", minimum=0.0, maximum=1.0, live=True),
    Parameter(
        "camera_covered",
        False,
        "a hand on the lens: black images without depth, and so no ball",
        live=True,
    ),
    Parameter(
        "joint_lag_s",
        0.0,
        "further lag of the joints behind the command",
        minimum=0.0,
        maximum=0.5,
        live=True,
    ),
    Parameter(
        "camera_rotation_deg",
        [0.0, 0.0, 0.0],
        "the camera bumped: turned about its own x, y, z axes from where it stood, degrees",
        size=3,
        minimum=-180.0,
        maximum=180.0,
        live=True,
    ),
    Parameter(
        "joint_state_order",
        ALPHABETICAL,
        "order of the joints in joint_states",
        choices=(ALPHABETICAL, KINEMATIC, SHUFFLED),
        live=True,
    ),
    Parameter(
        "extra_joints",
        "",
        "further joints mixed into joint_states (a gripper's), names separated by spaces",
    ),
    Parameter(
        "nan_joint",
        "",
        "a joint, by its name in joint_states, whose position is NaN; empty for none",
        live=True,
    ),
    Parameter(
        "play_driver_topics", True, "publish robot_program_running and speed_scaling as a UR does"
    ),
    Parameter(
        "program_running",
        True,
        "false: the robot's program is paused, the arm stands",
        live=True,
    ),
    Parameter(
        "announce_program_running",
        True,
        "false: nobody is told of a pause from now on; the arm just does not follow",
        live=True,
    ),
    Parameter(
        "speed_scaling_percent",
        100.0,
        "the driver's speed slider",
        minimum=0.0,
        maximum=100.0,
        live=True,
    ),
)
