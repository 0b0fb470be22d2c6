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
    #: When it appears, in words, if not at the start.
    later: str = ""


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
    #: Who else publishes it or subscribes to it, outside this package.
    also_from: str = ""
    also_to: str = ""


@dataclass(frozen=True)
class Node:
    """Services and description of a node."""

    #: What the node does, in a sentence.
    does: str
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
    SIM: Node(
        "Simulates an arm with a ball on its last link and a fixed depth camera, behind the topics "
        "of the real drivers.",
        {"~/reset": (_TRIGGER, "Puts the arm back to `initial_joints_rad`.")},
    ),
    DETECTOR: Node("Finds the ball in the colour and depth images of an RGB-D camera."),
    ESTIMATOR: Node(
        "Estimates the hand-eye Jacobian and, if its method learns, corrects it with every motion.",
        {
            "~/reset": (_TRIGGER, "Forgets what was learned online."),
            "~/freeze": ("std_srvs/srv/SetBool", "Stops the learning, or resumes it."),
        },
    ),
    CONTROLLER: Node(
        "Drives the ball to the target: one command for every joint state, "
        "each passed by the supervisor.",
        {
            "~/start": (_TRIGGER, "Lets the arm move, if everything is ready."),
            "~/stop": (_TRIGGER, "Brings the arm to rest; it moves again after a start."),
            "~/set_current_as_target": (_TRIGGER, "Makes the ball's position now the target."),
        },
    ),
    COLLECTOR: Node(
        "Moves the joints randomly and safely in a box, in place of the controller, and writes a "
        "data set to train on."
    ),
    CALIBRATE: Node(
        "Calibrates the camera in the arm's frame while anything moves the arm; moves nothing."
    ),
    DEMO: Node(
        "Gives the controller one target after another, judges by the simulator's truth, prints "
        "a table and draws a figure.",
        calls=(f"{CONTROLLER}/stop",),
    ),
    DASHBOARD: Node(
        "Serves a page for a browser: shows the arm, the camera image and the progress, and "
        "forwards targets, start, stop, and the choice of estimator and law.",
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
    MARKERS_NODE: Node("Shows ball, target and prediction in RViz and Foxglove."),
    RECORDER: Node("Records every topic into a bag, as sent.", subscribes_to_all=True),
}

_NEWEST, _RELIABLE, _LATCHED = End((Qos.NEWEST,)), End((Qos.RELIABLE,)), End((Qos.LATCHED,))
#: Receives from latched publishers and from others.
_EITHER = End((Qos.LATCHED, Qos.NEWEST))
_SIMULATED = End((Qos.RELIABLE,), given={"simulated_time": True})
#: Simulated time waits for a detector in place of the simulator's own.
_DETECTED = End((Qos.RELIABLE,), given={"simulated_time": True, "publish_ball_position": False})
_AT_THE_END = End((Qos.RELIABLE,), later="after the last target")
_WHILE_WATCHED = End((Qos.NEWEST,), later="while a browser shows the page")
_ONE_IMAGE = End((Qos.NEWEST,), later="after 15 s of motion, for one image")


def _taken(interface: str) -> End:
    return End((Qos.RELIABLE,), given={"command_interface": interface})


_DRIVER = "the robot's driver"
_CAMERA = "an RGB-D camera's driver"
_TOOLS = "any tool"
_VIEWERS = "RViz, Foxglove"


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
            also_from="your own detector or tracker",
        ),
        target=Topic(
            target[0],
            message_type,
            f"{target[1]} Latched or not.",
            ends(DEMO, DASHBOARD, of=_LATCHED),
            ends(CONTROLLER, of=_EITHER),
            also_from=YOU,
        ),
        sliding=Topic("sliding_variable", *sliding, ends(CONTROLLER), ends(ESTIMATOR, of=_NEWEST)),
        truth=Topic(
            f"{SIM}/true_{name}",
            message_type,
            f"The true value of `{name}`: for scoring, never for control.",
            ends(SIM),
            ends(DEMO),
            also_to=_TOOLS,
        ),
    )


JOINT_STATES = Topic(
    "joint_states",
    "sensor_msgs/msg/JointState",
    "Joint angles, rad, in any order; extra joints are ignored.",
    {SIM: _RELIABLE},
    dict.fromkeys((ESTIMATOR, CONTROLLER, COLLECTOR, CALIBRATE, DEMO, DASHBOARD), _NEWEST),
    also_from=_DRIVER,
    also_to=_TOOLS,
)
JACOBIAN = Topic(
    "jacobian",
    "std_msgs/msg/Float64MultiArray",
    "Motion per joint motion at the newest joints, a column for each joint, row by row, joints in "
    "kinematic order: of the ball, 3 rows, m/rad; of a tag its origin, then 3 rows of its turning, "
    "rad/rad, camera frame.",
    {ESTIMATOR: _RELIABLE},
    {SIM: _SIMULATED, CONTROLLER: _NEWEST},
)
KINEMATIC_CHAIN = Topic(
    "kinematic_chain",
    "std_msgs/msg/Float64MultiArray",
    "The arm as the camera sees it now, if `method` is `poe`, in the camera's optical frame: for "
    "each joint a row of 8, the direction of its axis, a point on it, m, the joint's reference "
    "position, rad (m), and 1 if it is prismatic; last, at the reference positions, a row of the "
    "ball, m, and zeros, or four of a tag's origin and its axes.",
    {ESTIMATOR: _RELIABLE},
    {CONTROLLER: _NEWEST},
)
COMMANDS, POSITION_COMMANDS = (
    Topic(
        f"forward_{interface}_controller/commands",
        "std_msgs/msg/Float64MultiArray",
        f"{words} Only with `command_interface` {interface}.",
        dict.fromkeys((CONTROLLER, COLLECTOR), _taken(interface)),
        {
            SIM: _taken(interface),
            CONTROLLER: replace(_taken(interface), later="another node publishing there"),
        },
        also_to=_DRIVER,
    )
    for interface, words in (
        (
            "velocity",
            "A velocity for each joint, rad/s, in kinematic order; the robot holds the last one "
            "for ever.",
        ),
        (
            "position",
            "A position for each joint, rad, in kinematic order, near where it is; none before a "
            "start and after the end.",
        ),
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
    "The robot as URDF: limits of the joints, and what a viewer draws; optional.",
    {SIM: _LATCHED},
    dict.fromkeys((CONTROLLER, COLLECTOR, CALIBRATE, DASHBOARD), _LATCHED),
    also_from=_DRIVER,
    also_to=_TOOLS,
)
#: Name prefixes of camera topics: the declared one, and that of the RealSense driver.
CAMERA_PREFIXES = ("camera", "camera/camera")


def camera_names(topic: Topic, prefix: str) -> list[str]:
    """Possible names of a camera's topic: below a prefix, or, if that is empty, the usual ones."""
    prefixes = (prefix.rstrip("/"),) if prefix else CAMERA_PREFIXES
    return [topic.name.replace(CAMERA_PREFIXES[0], one, 1) for one in prefixes]


COLOR_IMAGE = Topic(
    "camera/color/image_raw",
    "sensor_msgs/msg/Image",
    "Colour image, of any encoding; drawn only while a node subscribes.",
    {SIM: _RELIABLE},
    {
        DETECTOR: End((Qos.RELIABLE,), {"compressed_images": False}),
        DEMO: _AT_THE_END,
        DASHBOARD: _WHILE_WATCHED,
        CALIBRATE: _ONE_IMAGE,
    },
    also_from=_CAMERA,
)
DEPTH_IMAGE = Topic(
    "camera/aligned_depth_to_color/image_raw",
    "sensor_msgs/msg/Image",
    "Depth in the colour image's pixels, 16UC1 in mm (0 is unknown) or 32FC1 in m; "
    "drawn only while a node subscribes.",
    {SIM: _RELIABLE},
    {DETECTOR: End((Qos.RELIABLE,), {"compressed_images": False})},
    also_from=_CAMERA,
)
COLOR_IMAGE_COMPRESSED = Topic(
    f"{COLOR_IMAGE.name}/compressed",
    "sensor_msgs/msg/CompressedImage",
    "The colour image as jpeg or png.",
    subscribers={DETECTOR: End((Qos.RELIABLE,), {"compressed_images": True})},
    also_from=_CAMERA,
)
DEPTH_IMAGE_COMPRESSED = Topic(
    f"{DEPTH_IMAGE.name}/compressedDepth",
    "sensor_msgs/msg/CompressedImage",
    "The depth image as png.",
    subscribers={DETECTOR: End((Qos.RELIABLE,), {"compressed_images": True})},
    also_from=_CAMERA,
)
CAMERA_INFO = Topic(
    "camera/color/camera_info",
    "sensor_msgs/msg/CameraInfo",
    "The colour camera's pinhole model, at the image rate, images drawn or not.",
    {SIM: _RELIABLE},
    {
        DETECTOR: _NEWEST,
        DEMO: _AT_THE_END,
        DASHBOARD: _WHILE_WATCHED,
        CALIBRATE: _ONE_IMAGE,
    },
    also_from=_CAMERA,
)
STATUS = Topic(
    "~/status",
    "diagnostic_msgs/msg/DiagnosticStatus",
    "State, reason in words, and key numbers, 10 times per second.",
    dict.fromkeys(NODES, _RELIABLE),
    also_to=_TOOLS,
)
DIAGNOSTICS = Topic(
    "/diagnostics",
    "diagnostic_msgs/msg/DiagnosticArray",
    "State, and age, rate and jitter of every input, once per second.",
    dict.fromkeys(NODES, _RELIABLE),
    also_to=_TOOLS,
)
CLOCK = Topic(
    "/clock",
    "rosgraph_msgs/msg/Clock",
    "Simulated time.",
    {SIM: _SIMULATED},
    also_to="every node with use_sim_time",
)
MARKERS = Topic(
    "markers",
    "visualization_msgs/msg/MarkerArray",
    "Ball, its trail, target with its distance and predicted position, in the camera's optical "
    "frame; sent only while a node subscribes.",
    {MARKERS_NODE: _RELIABLE},
    also_to=_VIEWERS,
)
TF_STATIC = Topic(
    "/tf_static",
    "tf2_msgs/msg/TFMessage",
    "Pose of the simulated camera in the robot's root link, for viewing; and that of a calibrated "
    "one.",
    {
        MARKERS_NODE: End((Qos.LATCHED,), later="beside the simulator, with `tf2_msgs` installed"),
        CALIBRATE: End((Qos.LATCHED,), later="at the end, with `stay` and `tf2_msgs` installed"),
    },
    also_to=_VIEWERS,
)
TRUE_JACOBIAN = Topic(
    f"{SIM}/true_jacobian",
    "std_msgs/msg/Float64MultiArray",
    "The true Jacobian at every joint state, laid out as `jacobian`; "
    "computed only while a node subscribes.",
    {SIM: _RELIABLE},
    {ESTIMATOR: End((Qos.NEWEST,), {"method": "oracle"})},
)
TRUE_CAMERA_POSE = Topic(
    f"{SIM}/true_camera_pose",
    "geometry_msgs/msg/PoseStamped",
    "True pose of the camera's optical frame in the robot's root link: for viewing, never for "
    "control.",
    {SIM: _LATCHED},
    {DASHBOARD: _LATCHED, MARKERS_NODE: _LATCHED},
    also_to=_TOOLS,
)
ANNOTATED_IMAGE = Topic(
    f"{DETECTOR}/annotated_image",
    "sensor_msgs/msg/Image",
    "The colour image with what was found drawn in, rgb8; drawn only while a node subscribes.",
    {DETECTOR: _RELIABLE},
    also_to=_TOOLS,
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
