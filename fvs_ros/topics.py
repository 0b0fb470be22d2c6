"""Every topic and service of the package, declared once: who publishes, who subscribes, how.

The page ``docs/reference.md``, the access rules in ``config/sros2/policy.xml`` and the recorder
follow from it, and a test compares it with the running nodes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any, NamedTuple


class Qos(Enum):
    """Quality of service, in words for a user."""

    NEWEST = "best effort"
    RELIABLE = "reliable"
    LATCHED = "reliable, latched"


@dataclass(frozen=True)
class End:
    """How one node publishes or subscribes to a topic."""

    #: One publisher or subscription each.
    qos: tuple[Qos, ...]
    #: The node uses the topic only if these parameters have these values.
    given: Mapping[str, Any] = field(default_factory=dict)
    #: Whether it appears after the start.
    later: bool = False


@dataclass(frozen=True, eq=False)
class Topic:
    """One topic."""

    #: Relative to the namespace, absolute, or ``~/`` for one of each node.
    name: str
    #: Such as ``sensor_msgs/msg/JointState``.
    type: str
    #: For a user: what it holds, its unit and frame.
    description: str
    #: By the node's name.
    publishers: Mapping[str, End] = field(default_factory=dict)
    subscribers: Mapping[str, End] = field(default_factory=dict)
    #: Who else publishes it, outside this package.
    also_from: str = ""


@dataclass(frozen=True)
class Node:
    """Services of a node."""

    #: Name of a service -> its type, and what a call does.
    serves: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    #: Services of other nodes that it calls.
    calls: tuple[str, ...] = ()
    #: Whether it subscribes to whatever is published, as reliable and latched as that is.
    subscribes_to_all: bool = False


SIM, DETECTOR = "fvs_sim_node", "fvs_detector_node"
ESTIMATOR, CONTROLLER = "fvs_estimator_node", "fvs_controller_node"
COLLECTOR, DEMO, DASHBOARD = "fvs_collector_node", "fvs_demo_node", "fvs_dashboard"
MARKERS_NODE, RECORDER = "fvs_markers_node", "fvs_recorder_node"
CALIBRATE = "fvs_calibrate_node"
YOU = "you"  # an operator's tools, such as ``ros2 topic pub``
_TRIGGER = "std_srvs/srv/Trigger"

NODES: dict[str, Node] = {
    SIM: Node({"~/reset": (_TRIGGER, "Puts the arm back to `initial_joints_rad`.")}),
    DETECTOR: Node(),
    ESTIMATOR: Node(
        {
            "~/reset": (_TRIGGER, "Forgets what was learned online."),
            "~/freeze": ("std_srvs/srv/SetBool", "Stops the learning, or resumes it."),
        },
    ),
    CONTROLLER: Node(
        {
            "~/start": (_TRIGGER, "Lets the arm move, if everything is ready."),
            "~/stop": (_TRIGGER, "Brings the arm to rest; it moves again after a start."),
            "~/set_current_as_target": (_TRIGGER, "Makes what is seen now the target."),
        },
    ),
    COLLECTOR: Node(),
    CALIBRATE: Node(),
    DEMO: Node(calls=(f"{CONTROLLER}/stop",)),
    DASHBOARD: Node(
        calls=(
            *(f"{CONTROLLER}/{name}" for name in ("start", "stop", "set_current_as_target")),
            *(
                f"{node}/{name}"
                for node in (CONTROLLER, ESTIMATOR, SIM)
                for name in ("get_parameters", "set_parameters")
            ),
            f"{ESTIMATOR}/reset",
            f"{SIM}/reset",
        ),
    ),
    MARKERS_NODE: Node(),
    RECORDER: Node(subscribes_to_all=True),
}

_NEWEST, _RELIABLE, _LATCHED = End((Qos.NEWEST,)), End((Qos.RELIABLE,)), End((Qos.LATCHED,))
#: Receives from latched publishers and from others.
_EITHER = End((Qos.LATCHED, Qos.NEWEST))
_SIMULATED = End((Qos.RELIABLE,), given={"simulated_time": True})
#: Simulated time waits for a detector in place of the simulator's own.
_DETECTED = End((Qos.RELIABLE,), given={"simulated_time": True, "publish_ball_position": False})
#: Who looks at the camera's images now and then.
_VIEWERS = {
    DEMO: replace(_RELIABLE, later=True),
    DASHBOARD: replace(_NEWEST, later=True),
    CALIBRATE: replace(_NEWEST, later=True),
}
#: For images that are compressed, or not.
_COMPRESSED, _PLAIN = (
    End((Qos.RELIABLE,), given={"compressed_images": value}) for value in (True, False)
)


def _taken(interface: str) -> End:
    return End((Qos.RELIABLE,), given={"command_interface": interface})


_DRIVER = "the robot's driver"
_CAMERA = "a camera's driver"


class KindTopics(NamedTuple):
    """The topics of a kind of feature."""

    tool: Topic  #: what rides on the arm, as measured
    target: Topic
    sliding: Topic  #: the law's sliding variable
    truth: Topic  #: a simulator's truth, for scoring


def kind_topics(
    feature: str,
    message_type: str,
    tool: tuple[str, str],
    target: tuple[str, str],
    sliding: tuple[str, str],
) -> KindTopics:
    """Topics of a kind of feature.

    Parameters
    ----------
    feature : str
        Value of the parameter ``feature`` with which nodes use them.
    message_type : str
        Of measurement, target and truth.
    tool, target : tuple of str
        Name and description.
    sliding : tuple of str
        Message type and description.
    """

    def ends(*nodes: str, of: End = _RELIABLE) -> dict[str, End]:
        return dict.fromkeys(nodes, replace(of, given={"feature": feature, **of.given}))

    users = ESTIMATOR, CONTROLLER, COLLECTOR, CALIBRATE, DASHBOARD, MARKERS_NODE
    name, description = tool
    return KindTopics(
        tool=Topic(
            name,
            message_type,
            description,
            ends(SIM, DETECTOR),
            ends(*users, of=_NEWEST) | ends(SIM, of=_DETECTED),
            also_from="your own detector",
        ),
        target=Topic(
            target[0],
            message_type,
            target[1],
            ends(DEMO, DASHBOARD, of=_LATCHED),
            ends(CONTROLLER, of=_EITHER),
            also_from=YOU,
        ),
        sliding=Topic("sliding_variable", *sliding, ends(CONTROLLER), ends(ESTIMATOR, of=_NEWEST)),
        truth=Topic(
            f"{SIM}/true_{name}",
            message_type,
            f"The true `{name}`, for scoring.",
            ends(SIM),
            ends(DEMO),
        ),
    )


JOINT_STATES = Topic(
    "joint_states",
    "sensor_msgs/msg/JointState",
    "Joint positions, rad (m), in any order; extra joints are ignored.",
    {SIM: _RELIABLE},
    dict.fromkeys((ESTIMATOR, CONTROLLER, COLLECTOR, CALIBRATE, DEMO, DASHBOARD), _NEWEST),
    also_from=_DRIVER,
)
JACOBIAN = Topic(
    "jacobian",
    "std_msgs/msg/Float64MultiArray",
    "Feature Jacobian at the newest joints, row-major, camera frame: 3 x n, m/rad, or 6 x n for a "
    "tag (linear velocity of its origin, then angular velocity).",
    {ESTIMATOR: _RELIABLE},
    {SIM: _SIMULATED, CONTROLLER: _NEWEST},
)
KINEMATIC_CHAIN = Topic(
    "kinematic_chain",
    "std_msgs/msg/Float64MultiArray",
    "The arm in the camera's frame, with `method` `poe`. A row of 8 for each joint: axis, a point "
    "on it, m, reference position, rad (m), and 1 if prismatic. Last, at the reference positions, "
    "a row of the ball, m, and zeros, or four of a tag's origin and axes.",
    {ESTIMATOR: _RELIABLE},
    {CONTROLLER: _NEWEST},
)
COMMANDS, POSITION_COMMANDS = (
    Topic(
        f"forward_{interface}_controller/commands",
        "std_msgs/msg/Float64MultiArray",
        words,
        dict.fromkeys((CONTROLLER, COLLECTOR), _taken(interface)),
        {
            SIM: _taken(interface),
            CONTROLLER: replace(_taken(interface), later=True),
        },
    )
    for interface, words in (
        ("velocity", "Joint velocities, rad/s, in kinematic order; the robot holds the last one."),
        ("position", "Joint positions, rad, in kinematic order; none outside a session."),
    )
)
ROBOT_PROGRAM_RUNNING = Topic(
    "io_and_status_controller/robot_program_running",
    "std_msgs/msg/Bool",
    "Whether the robot obeys; optional.",
    {SIM: _LATCHED},
    dict.fromkeys((ESTIMATOR, CONTROLLER, COLLECTOR), _EITHER),
    also_from=_DRIVER,
)
SPEED_SCALING = Topic(
    "speed_scaling_state_broadcaster/speed_scaling",
    "std_msgs/msg/Float64",
    "The robot's speed slider, 0 to 100 %; optional.",
    {SIM: _RELIABLE},
    dict.fromkeys((ESTIMATOR, CONTROLLER, COLLECTOR), _NEWEST),
    also_from=_DRIVER,
)
ROBOT_DESCRIPTION = Topic(
    "robot_description",
    "std_msgs/msg/String",
    "The robot as URDF; optional.",
    {SIM: _LATCHED},
    dict.fromkeys((CONTROLLER, COLLECTOR, CALIBRATE, DASHBOARD), _LATCHED),
    also_from=_DRIVER,
)
#: Name prefixes of camera topics: the declared one, and that of the RealSense driver.
CAMERA_PREFIXES = ("camera", "camera/camera")


def camera_names(topic: Topic, prefix: str) -> list[str]:
    """Possible names of a camera's topic: below a prefix, or, if that is empty, the usual ones."""
    used_prefixes = (prefix.rstrip("/"),) if prefix else CAMERA_PREFIXES
    return [topic.name.replace(CAMERA_PREFIXES[0], used, 1) for used in used_prefixes]


COLOR_IMAGE = Topic(
    "camera/color/image_raw",
    "sensor_msgs/msg/Image",
    "Colour image, of any encoding.",
    {SIM: _RELIABLE},
    {DETECTOR: _PLAIN, **_VIEWERS},
    also_from=_CAMERA,
)
DEPTH_IMAGE = Topic(
    "camera/aligned_depth_to_color/image_raw",
    "sensor_msgs/msg/Image",
    "Depth in the colour image's pixels, 16UC1 in mm (0 is unknown) or 32FC1 in m.",
    {SIM: _RELIABLE},
    {DETECTOR: _PLAIN},
    also_from=_CAMERA,
)
COLOR_IMAGE_COMPRESSED = Topic(
    f"{COLOR_IMAGE.name}/compressed",
    "sensor_msgs/msg/CompressedImage",
    "The colour image as jpeg or png.",
    subscribers={DETECTOR: _COMPRESSED},
    also_from=_CAMERA,
)
DEPTH_IMAGE_COMPRESSED = Topic(
    f"{DEPTH_IMAGE.name}/compressedDepth",
    "sensor_msgs/msg/CompressedImage",
    "The depth image as png.",
    subscribers={DETECTOR: _COMPRESSED},
    also_from=_CAMERA,
)
CAMERA_INFO = Topic(
    "camera/color/camera_info",
    "sensor_msgs/msg/CameraInfo",
    "The colour camera's model, at the image rate.",
    {SIM: _RELIABLE},
    {DETECTOR: _NEWEST, **_VIEWERS},
    also_from=_CAMERA,
)
STATUS = Topic(
    "~/status",
    "diagnostic_msgs/msg/DiagnosticStatus",
    "State, reason in words, and key numbers, at 10 Hz.",
    dict.fromkeys(NODES, _RELIABLE),
)
DIAGNOSTICS = Topic(
    "/diagnostics",
    "diagnostic_msgs/msg/DiagnosticArray",
    "State, and age, rate and jitter of every input, at 1 Hz.",
    dict.fromkeys(NODES, _RELIABLE),
)
CLOCK = Topic("/clock", "rosgraph_msgs/msg/Clock", "Simulated time.", {SIM: _SIMULATED})
MARKERS = Topic(
    "markers",
    "visualization_msgs/msg/MarkerArray",
    "Ball or tag, its trail, target and prediction.",
    {MARKERS_NODE: _RELIABLE},
)
TF_STATIC = Topic(
    "/tf_static",
    "tf2_msgs/msg/TFMessage",
    "Pose of the simulated camera in the robot's root link, or, with `stay`, of the calibrated "
    "one; if `tf2_msgs` is installed.",
    dict.fromkeys((MARKERS_NODE, CALIBRATE), replace(_LATCHED, later=True)),
)
TRUE_JACOBIAN = Topic(
    f"{SIM}/true_jacobian",
    "std_msgs/msg/Float64MultiArray",
    "The true `jacobian`, at every joint state.",
    {SIM: _RELIABLE},
    {ESTIMATOR: End((Qos.NEWEST,), {"method": "oracle"})},
)
TRUE_CAMERA_POSE = Topic(
    f"{SIM}/true_camera_pose",
    "geometry_msgs/msg/PoseStamped",
    "True pose of the camera's optical frame in the robot's root link, for viewing.",
    {SIM: _LATCHED},
    {DASHBOARD: _LATCHED, MARKERS_NODE: _LATCHED},
)
ANNOTATED_IMAGE = Topic(
    f"{DETECTOR}/annotated_image",
    "sensor_msgs/msg/Image",
    "The colour image with what was found drawn in, rgb8.",
    {DETECTOR: _RELIABLE},
)
#: The status of one node, as others know it.
ESTIMATOR_STATUS, CONTROLLER_STATUS, DETECTOR_STATUS = (
    replace(STATUS, name=f"{node}/status", publishers={}, subscribers=subscribers)
    for node, subscribers in (
        (ESTIMATOR, {CONTROLLER: _NEWEST}),
        (CONTROLLER, {DEMO: _RELIABLE, DASHBOARD: _NEWEST, MARKERS_NODE: _NEWEST}),
        (DETECTOR, {DASHBOARD: _NEWEST}),
    )
)

#: All that every kind of feature has; :data:`fvs_ros.contract.TOPICS` are all.
COMMON = tuple(value for value in list(vars().values()) if isinstance(value, Topic))

#: What rclpy gives every node.
EVERY_NODE_PUBLISHES = ("/rosout", "/parameter_events")
EVERY_NODE_SUBSCRIBES = (CLOCK.name,)  # with use_sim_time only
EVERY_NODE_SERVES = tuple(
    f"~/{name}"
    for name in (
        "describe_parameters",
        "get_parameter_types",
        "get_parameters",
        "list_parameters",
        "set_parameters",
        "set_parameters_atomically",
        "get_type_description",
    )
)


def resolve(name: str, node: str, namespace: str = "") -> str:
    """The full name of a topic or service that a node uses, where nothing is remapped.

    The namespace may have slashes at its ends.
    """
    if name.startswith("/"):
        return name
    parts = [namespace.strip("/"), name.replace("~", node, 1)]
    return "/" + "/".join(part for part in parts if part)
