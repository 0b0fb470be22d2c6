"""The one part of the ground that knows ROS: node, messages, quality of service."""

from fvs_ros.ros.commands import CommandPublisher, LimitsReader, Ticker
from fvs_ros.ros.inputs import NeverReady, Sampled, take
from fvs_ros.ros.messages import (
    ERROR,
    OK,
    WARN,
    MessageError,
    from_camera_info,
    from_chain,
    from_feature,
    from_jacobian,
    from_stamp,
    from_status,
    message_class,
    to_camera_info,
    to_chain,
    to_command,
    to_feature,
    to_image,
    to_jacobian,
    to_joint_state,
    to_sliding,
    to_stamp,
    to_status,
)
from fvs_ros.ros.node import REPEAT_S, STATUS_PERIOD_S, FvsNode
from fvs_ros.ros.process import run
from fvs_ros.ros.qos import (
    PROFILES,
    QOS_EVENT,
    QOS_EVERY,
    QOS_LARGE,
    QOS_LATCHED,
    QOS_NEWEST,
    QOS_RELIABLE,
)
