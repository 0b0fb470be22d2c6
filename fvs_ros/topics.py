"""Every topic and service of the package, declared once: who publishes, who subscribes, how.

``docs/reference.md`` and the recorder follow from it, and a test compares it with running nodes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum, auto
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple


class Qos(Enum):
    """Quality of service."""

    NEWEST = auto()  #: best effort, which hears any publisher
    RELIABLE = auto()
    LATCHED = auto()  #: reliable, and who comes late gets the last message


@dataclass(frozen=True, eq=False)
class Topic:
    """One topic."""

    #: Relative to the namespace, absolute, or ``~/`` for one of each node.
    name: str
    #: Such as ``sensor_msgs/msg/JointState``.
    type: str
    #: For a user: what it holds, its unit and frame, and with which parameters.
    description: str
    #: Names of the nodes.
    publishers: tuple[str, ...] = ()
    subscribers: tuple[str, ...] = ()
    #: Who else publishes it, outside this package.
    also_from: str = ""
    #: What publishers offer.
    offers: Qos = Qos.RELIABLE
    #: One subscription each.
    asks: tuple[Qos, ...] = (Qos.NEWEST,)


SIM, DETECTOR = "fvs_sim_node", "fvs_detector_node"
ESTIMATOR, CONTROLLER = "fvs_estimator_node", "fvs_controller_node"
COLLECTOR, DEMO, DASHBOARD = "fvs_collector_node", "fvs_demo_node", "fvs_dashboard"
CALIBRATE, RECORDER = "fvs_calibrate_node", "fvs_recorder_node"
NODES = SIM, DETECTOR, ESTIMATOR, CONTROLLER, COLLECTOR, CALIBRATE, DEMO, DASHBOARD, RECORDER

_TRIGGER = "std_srvs/srv/Trigger"
#: Name of a service -> its type, and what a call does.
SERVICES = {
    f"{SIM}/reset": (
        _TRIGGER,
        "Puts the arm back to `initial_joints_rad`; stop the controller first.",
    ),
    f"{ESTIMATOR}/reset": (_TRIGGER, "Forgets what was learned online."),
    f"{ESTIMATOR}/freeze": ("std_srvs/srv/SetBool", "Stops the learning, or resumes it."),
    f"{CONTROLLER}/start": (_TRIGGER, "Lets the arm move, if everything is ready."),
    f"{CONTROLLER}/stop": (_TRIGGER, "Brings the arm to rest; it moves again after a start."),
    f"{CONTROLLER}/set_current_as_target": (_TRIGGER, "Makes what is seen now the target."),
    f"{CONTROLLER}/teach": (
        _TRIGGER,
        "Writes where the tool is at rest, seen from the object if one is seen, into "
        "`references_path`, as `reference`.",
    ),
    f"{CONTROLLER}/go_to_reference": (_TRIGGER, "Makes `reference` the target."),
}

#: Receives from latched publishers and from others.
_EITHER = (Qos.LATCHED, Qos.NEWEST)
_DRIVER = "the robot's driver"
_CAMERA = "a camera's driver"


class KindTopics(NamedTuple):
    """The topics of a kind of feature."""

    tool: Topic  #: what rides on the arm, as measured
    target: Topic
    object: Topic  #: what stands in the room, as measured
    sliding: Topic  #: the law's sliding variable
    truth: Topic  #: a simulator's truth, for scoring
    object_truth: Topic  #: the same of the object


def kind_topics(
    message_type: str,
    tool: tuple[str, str],
    target: tuple[str, str],
    seen_object: tuple[str, str],
    sliding_type: str = "std_msgs/msg/Float64MultiArray",
) -> KindTopics:
    """Topics of a kind of feature, by the names and descriptions of tool, target and object.

    Measurement, target and truth have one message type, the sliding variable has another.
    """

    def topic(name: str, description: str, publishers: tuple[str, ...], **more: Any) -> Topic:
        return Topic(name, message_type, description, publishers, **more)

    def truth(name: str) -> Topic:
        words = f"The true `{name}`, for scoring."
        return topic(f"{SIM}/true_{name}", words, (SIM,), subscribers=(DEMO, DASHBOARD))

    sources = SIM, DETECTOR
    measured: dict[str, Any] = {
        "subscribers": (SIM, ESTIMATOR, CONTROLLER, COLLECTOR, CALIBRATE, DASHBOARD),
        "also_from": "your own detector",
    }
    commanded: dict[str, Any] = {"also_from": "you", "offers": Qos.LATCHED, "asks": _EITHER}
    return KindTopics(
        tool=topic(*tool, sources, **measured),
        target=topic(*target, (DEMO, DASHBOARD), subscribers=(CONTROLLER,), **commanded),
        object=topic(*seen_object, sources, **measured),
        sliding=Topic(
            "sliding_variable",
            sliding_type,
            "The law's sliding variable after each image, for the estimator's update law.",
            (CONTROLLER,),
            (ESTIMATOR,),
        ),
        truth=truth(tool[0]),
        object_truth=truth(seen_object[0]),
    )


JOINT_STATES = Topic(
    "joint_states",
    "sensor_msgs/msg/JointState",
    "Joint positions, rad (m), in any order; extra joints are ignored.",
    (SIM,),
    (ESTIMATOR, CONTROLLER, COLLECTOR, CALIBRATE, DEMO, DASHBOARD),
    also_from=_DRIVER,
)
JACOBIAN = Topic(
    "jacobian",
    "std_msgs/msg/Float64MultiArray",
    "Feature Jacobian at the newest joints, row-major, camera frame: a row, per rad, for each "
    "number of the feature's motion (of a tag: its origin's linear, then its angular velocity).",
    (ESTIMATOR,),
    (SIM, CONTROLLER),
)
KINEMATIC_CHAIN = Topic(
    "kinematic_chain",
    "std_msgs/msg/Float64MultiArray",
    "The arm in the camera's frame, with `method` `poe`. A row of 9 for each joint: axis, a point "
    "on it, m, reference position, rad (m), 1 if prismatic, and its play, rad (m). Last, at the "
    "reference positions, a row of the ball, m, or four of a tag's origin and axes. The first "
    "continues with the lens' errors of focal length and k1; the rest are zeros.",
    (ESTIMATOR,),
    (CONTROLLER,),
)
COMMANDS, POSITION_COMMANDS = (
    Topic(
        f"forward_{interface}_controller/commands",
        "std_msgs/msg/Float64MultiArray",
        f"{words} With `command_interface` `{interface}`.",
        (CONTROLLER, COLLECTOR),
        (SIM, CONTROLLER),
        asks=(Qos.RELIABLE,),
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
    (SIM,),
    (ESTIMATOR, CONTROLLER, COLLECTOR),
    also_from=_DRIVER,
    offers=Qos.LATCHED,
    asks=_EITHER,
)
SPEED_SCALING = Topic(
    "speed_scaling_state_broadcaster/speed_scaling",
    "std_msgs/msg/Float64",
    "The robot's speed slider, 0 to 100 %; optional.",
    (SIM,),
    (ESTIMATOR, CONTROLLER, COLLECTOR),
    also_from=_DRIVER,
)
ROBOT_DESCRIPTION = Topic(
    "robot_description",
    "std_msgs/msg/String",
    "The robot as URDF; optional.",
    (SIM,),
    (CONTROLLER, COLLECTOR, CALIBRATE, DASHBOARD),
    also_from=_DRIVER,
    offers=Qos.LATCHED,
    asks=(Qos.LATCHED,),
)
#: Name prefixes of camera topics: the declared one, and that of the RealSense driver.
CAMERA_PREFIXES = ("camera", "camera/camera")


def camera_names(topic: Topic, prefix: str, camera: str = "") -> list[str]:
    """Possible names of a camera's topic.

    They are below a prefix, or, if that is empty, the usual ones; of a named camera below its name.
    """
    prefixes = (prefix.rstrip("/"),) if prefix else CAMERA_PREFIXES
    names = [topic.name.replace(CAMERA_PREFIXES[0], used, 1) for used in prefixes]
    if not prefix:  # as usb_cam and v4l2_camera have it
        names.append(topic.name.rpartition("/")[2])
    return [f"{camera}/{name}" if camera else name for name in names]


def of_camera(topic: Topic, camera: str) -> Topic:
    """The topic of a named camera, below its name."""
    return replace(topic, name=f"{camera}/{topic.name}") if camera else topic


COLOR_IMAGE = Topic(
    "camera/color/image_raw",
    "sensor_msgs/msg/Image",
    "Colour image, of any encoding.",
    (SIM,),
    (DETECTOR, DASHBOARD),
    also_from=_CAMERA,
    asks=(Qos.RELIABLE,),
)
DEPTH_IMAGE = Topic(
    "camera/aligned_depth_to_color/image_raw",
    "sensor_msgs/msg/Image",
    "Depth in the colour image's pixels, 16UC1 in mm (0 is unknown) or 32FC1 in m; for a ball.",
    (SIM,),
    (DETECTOR,),
    also_from=_CAMERA,
    asks=(Qos.RELIABLE,),
)
CAMERA_INFO = Topic(
    "camera/color/camera_info",
    "sensor_msgs/msg/CameraInfo",
    "The colour camera's model, at the image rate.",
    (SIM,),
    (DETECTOR, DASHBOARD),
    also_from=_CAMERA,
)
STATUS = Topic(
    "~/status",
    "diagnostic_msgs/msg/DiagnosticStatus",
    "State, reason in words, and key numbers, at 10 Hz.",
    NODES,
)
DIAGNOSTICS = Topic(
    "/diagnostics",
    "diagnostic_msgs/msg/DiagnosticArray",
    "State, and age, rate and jitter of every input, at 1 Hz.",
    NODES,
)
CLOCK = Topic("/clock", "rosgraph_msgs/msg/Clock", "Simulated time, with `simulated_time`.", (SIM,))
TF_STATIC = Topic(
    "/tf_static",
    "tf2_msgs/msg/TFMessage",
    "Pose of the camera in the robot's root link, or in that which carries it; the simulator's if "
    "`tf2_msgs` is installed.",
    (SIM,),
    (DASHBOARD,),
    also_from="static_transform_publisher",
    offers=Qos.LATCHED,
    asks=(Qos.LATCHED,),
)
TRUE_CAMERA_POSE = Topic(
    f"{SIM}/true_camera_pose",
    "geometry_msgs/msg/PoseStamped",
    "True pose of the camera's optical frame in the link that carries it, for viewing.",
    (SIM,),
    (DASHBOARD,),
    offers=Qos.LATCHED,
    asks=(Qos.LATCHED,),
)
ANNOTATED_IMAGE = Topic(
    f"{DETECTOR}/annotated_image",
    "sensor_msgs/msg/Image",
    "The colour image with what was found drawn in, rgb8.",
    (DETECTOR,),
)
#: The status of one node, as others know it.
ESTIMATOR_STATUS, CONTROLLER_STATUS, DETECTOR_STATUS = (
    replace(STATUS, name=f"{node}/status", publishers=(), subscribers=subscribers)
    for node, subscribers in (
        (ESTIMATOR, (CONTROLLER,)),
        (CONTROLLER, (DEMO, DASHBOARD)),
        (DETECTOR, (DASHBOARD,)),
    )
)

#: All but those of the kinds of features.
COMMON = tuple(value for value in list(vars().values()) if isinstance(value, Topic))


@cache
def message_class(name: str) -> type:
    """The class of a message type such as ``sensor_msgs/msg/JointState``."""
    module, _, of_type = name.rpartition("/")
    return getattr(import_module(module.replace("/", ".")), of_type)
