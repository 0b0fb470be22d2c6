"""Parameters of ``fvs_collector_node``, declared once."""

from __future__ import annotations

from math import pi

from fvs_estimator_node.config import MAX_LATENCY
from fvs_ros.camera import CAMERA_FRAME
from fvs_ros.joints import (
    JOINT_PARAMETERS,
    N_JOINTS,
    TRAINING_BOX_RAD,
    UR_POSITION_LIMITS_RAD,
)
from fvs_ros.params import Parameter

PARAMETERS = (
    Parameter("output_path", "out/collect/dataset.npz", "data set file to write"),
    Parameter(
        "duration_s", 120.0, "how long to move and record, at most", minimum=2.0, maximum=7200.0
    ),
    Parameter(
        "stop_at_error",
        0.0,
        "relative standard deviation of the Jacobian in the box of motion at which collecting ends "
        "early (0.002 is a good value for `fvs_train --method poe`); the motion then also goes "
        "where it learns most; 0 is off: the same motion for all of duration_s",
        minimum=0.0,
        maximum=0.5,
    ),
    Parameter("seed", 0, "seed of the motion", minimum=0),
    Parameter(
        "joint_range_rad",
        list(TRAINING_BOX_RAD),
        "half width of the box of motion about the joints at the start",
        size=N_JOINTS,
        minimum=0.0,
        maximum=3.2,
        broadcast=True,
    ),
    Parameter(
        "max_joint_velocity_rad_s", 0.65, "velocity limit of each joint", minimum=0.01, maximum=3.15
    ),
    Parameter(
        "max_joint_acceleration_rad_s2",
        3.0,
        "acceleration limit of each joint's command",
        minimum=0.1,
        maximum=40.0,
    ),
    Parameter(
        "joint_min_rad",
        [-limit for limit in UR_POSITION_LIMITS_RAD],
        "lower ends of the joints' ranges, rad; the box of motion ends 0.1 rad before them",
        minimum=-4.0 * pi,
        maximum=4.0 * pi,
        size=N_JOINTS,
    ),
    Parameter(
        "joint_max_rad",
        list(UR_POSITION_LIMITS_RAD),
        "upper ends of the joints' ranges, rad; the box of motion ends 0.1 rad before them",
        minimum=-4.0 * pi,
        maximum=4.0 * pi,
        size=N_JOINTS,
    ),
    *JOINT_PARAMETERS,
    MAX_LATENCY,
    Parameter("feature_frame", CAMERA_FRAME, "frame of the ball positions"),
    Parameter(
        "joint_states_max_age_s",
        0.1,
        "older joint states stop the arm, s",
        minimum=0.02,
        maximum=2.0,
    ),
    Parameter(
        "ball_max_age_s",
        0.5,
        "without the ball for so long, the arm goes back toward the start until it is seen again",
        minimum=0.05,
        maximum=10.0,
    ),
    Parameter(
        "give_up_s",
        10.0,
        "without joint states or without the ball for so long, it ends with an error",
        minimum=1.0,
        maximum=600.0,
    ),
)
