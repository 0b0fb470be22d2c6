"""Every topic and service of the package, declared once, and which node has which.

The nodes, the page ``docs/reference.md`` and the access rules in
``config/sros2/policy.xml`` follow from it, and a test compares it with the running nodes. So a
name that is not here is a name that does not exist.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any


class Qos(Enum):
    """How messages travel: reliability, durability, and the same in words for a user."""

    NEWEST = ("best effort", "volatile", "best effort")
    RELIABLE = ("reliable", "volatile", "reliable")
    LATCHED = ("reliable", "transient local", "reliable, latched")

    def __init__(self, reliability: str, durability: str, words: str) -> None:
        self.reliability = reliability
        self.durability = durability
        self.words = words


@dataclass(frozen=True)
class Topic:
    """One topic.

    Parameters
    ----------
    name : str
        Name as the code writes it: relative, ``~/`` (below its node) or absolute.
    type : str
        Message type, such as ``sensor_msgs/msg/JointState``.
    description : str
        For a user: what it holds, its unit and frame.
    also_from, also_to : str
        Who else publishes or hears it, outside this package.
    """

    name: str
    type: str
    description: str
    also_from: str = ""
    also_to: str = ""

    def of(self, node: str) -> Topic:
        """The ``~/`` topic of a node, under the name by which others know it."""
        return replace(self, name=self.name.replace("~", node, 1))


@dataclass(frozen=True)
class Service:
    """One service.

    Parameters
    ----------
    name : str
        Name as the code writes it.
    type : str
        Service type, such as ``std_srvs/srv/Trigger``.
    description : str
        For a user: what a call does.
    """

    name: str
    type: str
    description: str


@dataclass(frozen=True)
class End:
    """A topic as one node publishes or subscribes to it.

    Parameters
    ----------
    topic : Topic
        Which.
    qos : tuple of Qos
        One publisher or subscription each.
    given : tuple of str and value, optional
        Parameter of the node, and its value without which the node does without the topic.
    later : str
        What must have happened before, in words, if it is not there from the start on.
    note : str
        What else a user should know of this end.
    """

    topic: Topic
    qos: tuple[Qos, ...]
    given: tuple[str, Any] | None = None
    later: str = ""
    note: str = ""


@dataclass(frozen=True)
class Interface:
    """All that one node has on the wire.

    Parameters
    ----------
    does : str
        What the node does, in a sentence.
    publishes, subscribes : tuple of End
        Its topics.
    serves : tuple of Service
        Its services.
    hears_all : bool
        Whether it subscribes to whatever is published, too, as reliable and latched as that is.
    calls : tuple of str
        Services of other nodes that it calls, by the names under which others know them.
    """

    does: str
    publishes: tuple[End, ...]
    subscribes: tuple[End, ...]
    serves: tuple[Service, ...] = ()
    hears_all: bool = False
    calls: tuple[str, ...] = ()


_DRIVER = "the robot's driver"
_OWN_DETECTOR = "your own detector"
_CAMERA = "an RGB-D camera's driver"
_TOOLS = "any tool"

JOINT_STATES = Topic(
    "joint_states",
    "sensor_msgs/msg/JointState",
    "Joint angles, rad, in any order; extra joints are passed over.",
    also_from=_DRIVER,
    also_to=_TOOLS,
)
BALL_POSITION = Topic(
    "ball_position",
    "geometry_msgs/msg/PointStamped",
    "The ball's centre, m, in the camera's optical frame, stamped with the exposure; "
    "silent while the ball is not seen.",
    also_from=_OWN_DETECTOR,
)
JACOBIAN = Topic(
    "jacobian",
    "std_msgs/msg/Float64MultiArray",
    "Ball motion per joint motion at the newest joints, m/rad: 3 rows (feature) of 6 columns "
    "(joint), row by row, joints in kinematic order.",
)
KINEMATIC_CHAIN = Topic(
    "kinematic_chain",
    "std_msgs/msg/Float64MultiArray",
    "The arm as the camera sees it now: 15 rows of x, y, z, row by row. Rows 0 to 5 are the "
    "directions of the joints' axes, 6 to 11 a point on each, m, 12 the ball, m, all in the "
    "camera's optical frame, where the joints stand as rows 13 and 14 say, rad.",
)
TARGET_POSITION = Topic(
    "target_position",
    "geometry_msgs/msg/PointStamped",
    "Where the ball shall go, m, in the frame of the ball position; latched or not.",
    also_from="you",
)
SLIDING_VARIABLE = Topic(
    "sliding_variable",
    "geometry_msgs/msg/Vector3Stamped",
    "The control law's sliding variable, for the estimator's update law.",
)
COMMANDS = Topic(
    "forward_velocity_controller/commands",
    "std_msgs/msg/Float64MultiArray",
    "Six joint velocities, rad/s, in kinematic order; the robot holds the last one for ever.",
    also_to=_DRIVER,
)
ROBOT_PROGRAM_RUNNING = Topic(
    "io_and_status_controller/robot_program_running",
    "std_msgs/msg/Bool",
    "Whether the robot obeys; optional.",
    also_from=_DRIVER,
)
SPEED_SCALING = Topic(
    "speed_scaling_state_broadcaster/speed_scaling",
    "std_msgs/msg/Float64",
    "The robot's speed slider, 0 to 100 %; optional.",
    also_from=_DRIVER,
)
ROBOT_DESCRIPTION = Topic(
    "robot_description",
    "std_msgs/msg/String",
    "The robot as URDF: what a viewer draws.",
    also_from=_DRIVER,
    also_to=_TOOLS,
)
#: Below which names cameras publish: the declared one, and that of a RealSense's driver.
CAMERA_PREFIXES = ("camera", "camera/camera")

COLOR_IMAGE = Topic(
    "camera/color/image_raw",
    "sensor_msgs/msg/Image",
    "Colour image, rgb8; drawn only while somebody subscribes.",
    also_from=_CAMERA,
)
DEPTH_IMAGE = Topic(
    "camera/aligned_depth_to_color/image_raw",
    "sensor_msgs/msg/Image",
    "Depth in the colour image's pixels, 16UC1 in mm (0 is unknown) or 32FC1 in m; "
    "drawn only while somebody subscribes.",
    also_from=_CAMERA,
)
COLOR_IMAGE_COMPRESSED = Topic(
    f"{COLOR_IMAGE.name}/compressed",
    "sensor_msgs/msg/CompressedImage",
    "The colour image as jpeg or png.",
    also_from=_CAMERA,
)
DEPTH_IMAGE_COMPRESSED = Topic(
    f"{DEPTH_IMAGE.name}/compressedDepth",
    "sensor_msgs/msg/CompressedImage",
    "The depth image as png.",
    also_from=_CAMERA,
)
CAMERA_INFO = Topic(
    "camera/color/camera_info",
    "sensor_msgs/msg/CameraInfo",
    "The colour camera's pinhole model, at the image rate, images drawn or not.",
    also_from=_CAMERA,
)
STATUS = Topic(
    "~/status",
    "diagnostic_msgs/msg/DiagnosticStatus",
    "State, reason in words, and key numbers, 10 times a second.",
    also_to=_TOOLS,
)
DIAGNOSTICS = Topic(
    "/diagnostics",
    "diagnostic_msgs/msg/DiagnosticArray",
    "State, and age, rate and jitter of every input, once a second.",
    also_to=_TOOLS,
)
CLOCK = Topic(
    "/clock",
    "rosgraph_msgs/msg/Clock",
    "Simulated time.",
    also_to="every node with use_sim_time",
)

MARKERS = Topic(
    "markers",
    "visualization_msgs/msg/MarkerArray",
    "Ball, its trail, target with its distance and predicted position, in the camera's optical "
    "frame; sent only while somebody subscribes.",
    also_to="RViz, Foxglove",
)
TF_STATIC = Topic(
    "/tf_static",
    "tf2_msgs/msg/TFMessage",
    "Where the simulated camera stands, from `base_link`: to look at.",
    also_to="RViz, Foxglove",
)

_TRUE_BALL_POSITION = Topic(
    "~/true_ball_position",
    "geometry_msgs/msg/PointStamped",
    "Where the ball really is, m, in the camera's optical frame: to judge by, never to control by.",
    also_to=_TOOLS,
)
_TRUE_JACOBIAN = Topic(
    "~/true_jacobian",
    "std_msgs/msg/Float64MultiArray",
    "The true Jacobian at every joint state, laid out as `jacobian`; "
    "computed only while somebody subscribes.",
)

_TRUE_CAMERA_POSE = Topic(
    "~/true_camera_pose",
    "geometry_msgs/msg/PoseStamped",
    "Where the camera's optical frame really is, in the robot's `base_link`: to look at, never to "
    "control by.",
    also_to=_TOOLS,
)

_ANNOTATED_IMAGE = Topic(
    "~/annotated_image",
    "sensor_msgs/msg/Image",
    "The colour image with what was found drawn in, rgb8; drawn only while somebody subscribes.",
    also_to=_TOOLS,
)

ESTIMATOR_STATUS = STATUS.of("fvs_estimator_node")
CONTROLLER_STATUS = STATUS.of("fvs_controller_node")
DETECTOR_STATUS = STATUS.of("fvs_detector_node")
TRUE_BALL_POSITION = _TRUE_BALL_POSITION.of("fvs_sim_node")
TRUE_JACOBIAN = _TRUE_JACOBIAN.of("fvs_sim_node")
TRUE_CAMERA_POSE = _TRUE_CAMERA_POSE.of("fvs_sim_node")

_TRIGGER = "std_srvs/srv/Trigger"

_NEWEST, _RELIABLE, _LATCHED = (Qos.NEWEST,), (Qos.RELIABLE,), (Qos.LATCHED,)
#: Heard from a latched publisher and from one that is not.
_EITHER = (Qos.LATCHED, Qos.NEWEST)

_ALWAYS = (End(STATUS, _RELIABLE), End(DIAGNOSTICS, _RELIABLE))
_ROBOT_STATE = (End(ROBOT_PROGRAM_RUNNING, _EITHER), End(SPEED_SCALING, _NEWEST))
_SIMULATED = ("simulated_time", True)
_IMAGE_RELIABILITY = "best effort if a publisher is best effort"
_CAMERA_TOPICS = (
    "this, and the images, below `camera/camera` if that is what a camera publishes, or below what "
    "`camera_topics` says"
)
_AT_THE_END = "after the last target"
_WHILE_WATCHED = "while a browser shows the page"

#: What each node has on the wire, by name.
INTERFACES: dict[str, Interface] = {
    "fvs_sim_node": Interface(
        "Simulates a UR5, a ball on its flange and a fixed depth camera, and speaks as the "
        "drivers of the real ones do.",
        publishes=(
            End(JOINT_STATES, _RELIABLE),
            End(BALL_POSITION, _RELIABLE),
            End(COLOR_IMAGE, _RELIABLE),
            End(DEPTH_IMAGE, _RELIABLE),
            End(CAMERA_INFO, _RELIABLE),
            End(ROBOT_PROGRAM_RUNNING, _LATCHED),
            End(SPEED_SCALING, _RELIABLE),
            End(_TRUE_BALL_POSITION, _RELIABLE),
            End(_TRUE_JACOBIAN, _RELIABLE),
            End(_TRUE_CAMERA_POSE, _LATCHED),
            End(ROBOT_DESCRIPTION, _LATCHED),
            End(CLOCK, _RELIABLE, given=_SIMULATED),
            *_ALWAYS,
        ),
        subscribes=(
            End(COMMANDS, _RELIABLE),
            End(JACOBIAN, _RELIABLE, given=_SIMULATED, note="waited for, not read"),
        ),
        serves=(Service("~/reset", _TRIGGER, "Puts the arm back to `initial_joints_rad`."),),
    ),
    "fvs_detector_node": Interface(
        "Finds the ball in the colour and depth images of an RGB-D camera.",
        publishes=(End(BALL_POSITION, _RELIABLE), End(_ANNOTATED_IMAGE, _RELIABLE), *_ALWAYS),
        subscribes=(
            *(
                End(topic, _RELIABLE, given=given, note=_IMAGE_RELIABILITY)
                for topic, given in (
                    (COLOR_IMAGE, ("color_transport", "raw")),
                    (COLOR_IMAGE_COMPRESSED, ("color_transport", "compressed")),
                    (DEPTH_IMAGE, ("depth_transport", "raw")),
                    (DEPTH_IMAGE_COMPRESSED, ("depth_transport", "compressedDepth")),
                )
            ),
            End(CAMERA_INFO, _NEWEST, note=_CAMERA_TOPICS),
        ),
    ),
    "fvs_estimator_node": Interface(
        "Estimates the hand-eye Jacobian and, if its method learns, corrects it with every motion.",
        publishes=(
            End(JACOBIAN, _RELIABLE),
            End(KINEMATIC_CHAIN, _RELIABLE, note="silent unless `method` is `poe`"),
            *_ALWAYS,
        ),
        subscribes=(
            End(JOINT_STATES, _NEWEST),
            End(BALL_POSITION, _NEWEST),
            End(SLIDING_VARIABLE, _NEWEST),
            *_ROBOT_STATE,
            End(TRUE_JACOBIAN, _NEWEST, given=("method", "oracle")),
        ),
        serves=(
            Service("~/reset", _TRIGGER, "Forgets what was learned online."),
            Service("~/freeze", "std_srvs/srv/SetBool", "Stops the learning, or lets it go on."),
        ),
    ),
    "fvs_controller_node": Interface(
        "Drives the ball to the target: one command for every joint state, "
        "each passed by the supervisor.",
        publishes=(End(COMMANDS, _RELIABLE), End(SLIDING_VARIABLE, _RELIABLE), *_ALWAYS),
        subscribes=(
            End(JOINT_STATES, _NEWEST),
            End(BALL_POSITION, _NEWEST),
            End(JACOBIAN, _NEWEST),
            End(KINEMATIC_CHAIN, _NEWEST),
            End(TARGET_POSITION, _EITHER),
            End(ESTIMATOR_STATUS, _NEWEST),
            End(COMMANDS, _RELIABLE, later="another node publishing there"),
            *_ROBOT_STATE,
        ),
        serves=(
            Service("~/start", _TRIGGER, "Lets the arm move, if everything is ready."),
            Service("~/stop", _TRIGGER, "Brings the arm to rest; it moves again after a start."),
            Service(
                "~/set_current_as_target", _TRIGGER, "Makes the ball's position now the target."
            ),
        ),
    ),
    "fvs_collector_node": Interface(
        "Moves the joints randomly and safely in a box, in place of the controller, and writes a "
        "data set to train on.",
        publishes=(End(COMMANDS, _RELIABLE), *_ALWAYS),
        subscribes=(End(JOINT_STATES, _NEWEST), End(BALL_POSITION, _NEWEST), *_ROBOT_STATE),
    ),
    "fvs_demo_node": Interface(
        "Gives the controller one target after another, judges by the simulator's truth, prints "
        "a table and draws a figure.",
        publishes=(End(TARGET_POSITION, _LATCHED), *_ALWAYS),
        subscribes=(
            End(CONTROLLER_STATUS, _RELIABLE),
            End(TRUE_BALL_POSITION, _RELIABLE, note="every one of them, to judge by"),
            End(JOINT_STATES, _NEWEST),
            End(COLOR_IMAGE, _RELIABLE, later=_AT_THE_END),
            End(CAMERA_INFO, _RELIABLE, later=_AT_THE_END),
        ),
        calls=("fvs_controller_node/stop",),
    ),
    "fvs_dashboard": Interface(
        "Serves a page for a browser: shows the arm, the camera's picture and how well it goes, "
        "and hands on targets, start, stop, and which estimator and law shall run.",
        publishes=(End(TARGET_POSITION, _LATCHED), *_ALWAYS),
        subscribes=(
            End(JOINT_STATES, _NEWEST),
            End(BALL_POSITION, _NEWEST),
            End(CONTROLLER_STATUS, _NEWEST),
            End(DETECTOR_STATUS, _NEWEST),
            End(ROBOT_DESCRIPTION, _LATCHED),
            End(TRUE_CAMERA_POSE, _LATCHED),
            End(COLOR_IMAGE, _NEWEST, given=("image", True), later=_WHILE_WATCHED),
            End(
                CAMERA_INFO,
                _NEWEST,
                given=("image", True),
                later=_WHILE_WATCHED,
                note="this, and the image, below `camera/camera` as well",
            ),
        ),
        calls=(
            "fvs_controller_node/start",
            "fvs_controller_node/stop",
            "fvs_controller_node/set_current_as_target",
            "fvs_controller_node/get_parameters",
            "fvs_controller_node/set_parameters",
            "fvs_estimator_node/get_parameters",
            "fvs_estimator_node/set_parameters",
            "fvs_estimator_node/reset",
            "fvs_sim_node/get_parameters",
            "fvs_sim_node/set_parameters",
            "fvs_sim_node/reset",
        ),
    ),
    "fvs_markers_node": Interface(
        "Shows ball, target and prediction in RViz and Foxglove.",
        publishes=(
            End(MARKERS, _RELIABLE),
            End(
                TF_STATIC,
                _LATCHED,
                later="when the simulator has told where its camera stands, and `tf2_msgs` is "
                "installed",
            ),
            *_ALWAYS,
        ),
        subscribes=(
            End(BALL_POSITION, _NEWEST),
            End(CONTROLLER_STATUS, _NEWEST),
            End(TRUE_CAMERA_POSE, _LATCHED),
        ),
    ),
    "fvs_recorder_node": Interface(
        "Records every topic into a bag, as it is on the wire.",
        publishes=_ALWAYS,
        subscribes=(),
        hears_all=True,
    ),
}

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
    """The full name of a topic or service.

    Parameters
    ----------
    name : str
        Name as declared.
    node : str
        The node that uses it.
    namespace : str
        The node's namespace, with or without slashes at its ends.

    Returns
    -------
    str
        As ROS resolves it where nothing is remapped.
    """
    if name.startswith("/"):
        return name
    parts = [namespace.strip("/"), name.replace("~", node, 1)]
    return "/" + "/".join(part for part in parts if part)


def nodes_with(topic: Topic, publishing: bool) -> list[str]:
    """Names of the nodes that publish (or subscribe to) a topic, whoever's ``~`` it is below."""

    def names(node: str, ends: Iterable[End]) -> set[str]:
        return {resolve(end.topic.name, node) for end in ends}

    owners = list(INTERFACES) if topic.name.startswith("~") else [""]
    wanted = {resolve(topic.name, owner) for owner in owners}
    found = []
    for node, interface in INTERFACES.items():
        ends = interface.publishes if publishing else interface.subscribes
        if names(node, ends) & wanted:
            found.append(node)
    return found


def declared_topics() -> list[Topic]:
    """Every topic once, under the name its publisher gives it."""
    found: dict[str, Topic] = {}
    known: set[str] = set()
    for publishing in (True, False):
        for node, interface in INTERFACES.items():
            for end in interface.publishes if publishing else interface.subscribes:
                full = resolve(end.topic.name, node)
                if publishing or full not in known:
                    found.setdefault(end.topic.name, end.topic)
                known.add(full)
    return list(found.values())
