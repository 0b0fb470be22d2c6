"""Parameters of ``fvs_sim_node``, declared once."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import ceil

from fvs_detector_node.tags import TagsConfig
from fvs_ros.arguments import unknown
from fvs_ros.camera import FeatureConfig, Intrinsics
from fvs_ros.interface import CommandInterface
from fvs_ros.kinds.kind import UNNAMED
from fvs_ros.params import ParameterError, live_parameter, parameter
from fvs_sim_node.camera import CAMERAS, Lens, RigidPose
from fvs_sim_node.robot import ROBOTS

BALL_RGBA = (0.86, 0.07, 0.06, 1.0)


@dataclass(frozen=True)
class SceneObject:
    """A sphere or a box that only the camera sees."""

    position_m: tuple[float, float, float]  # centre, world frame
    size_m: tuple[float, ...]  # radius of a sphere, or three edge lengths of a box
    rgba: tuple[float, float, float, float] = BALL_RGBA


#: A table of light wood, low enough for the ball to pass over, and a foot for the arm.
TABLE = (
    SceneObject((0.30, 0.0, -0.22), (1.40, 1.20, 0.04), (0.87, 0.80, 0.68, 1.0)),
    SceneObject((0.0, 0.0, -0.10), (0.20, 0.20, 0.20), (0.45, 0.50, 0.56, 1.0)),
)


@dataclass(frozen=True)
class SimConfig(TagsConfig, CommandInterface):
    """Parameters of the simulation; fields without a description are for Python only."""

    seed: int = parameter(0, "seed of all noise: same seed, same run", 0)
    gui: bool = parameter(False, "open PyBullet's window (needs a display)")
    robot: str = parameter("ur5", "which known robot", choices=tuple(ROBOTS))
    urdf_path: str = parameter("", "URDF of any other robot")
    ball_link: str = parameter(
        "",
        "link that carries the ball, or the camera; empty: the known robot's, else tool0, else the "
        "last link",
    )
    initial_joints_rad: tuple[float, ...] = parameter(
        (),
        "joints at start and after ~/reset; empty: a well-conditioned pose",
        -6.3,
        6.3,
    )
    ball_radius_m: float = parameter(0.04, "radius of the ball", 0.01, 0.2)
    use_depth: bool = parameter(True, "whether depth tells the ball's distance; or its drawn size")
    object_position_m: tuple[float, ...] = live_parameter(
        (0.45, -0.1, 0.05),
        "middle of the object, world frame; it jumps there; by default before a camera on the arm",
        -5.0,
        5.0,
        size=3,
    )
    object_rotation_deg: tuple[float, ...] = live_parameter(
        (75.0, 40.0, 30.0),
        "rotation vector of the object, world frame; zeros: it lies on its back",
        -180.0,
        180.0,
        size=3,
    )
    object_velocity_m_s: tuple[float, ...] = live_parameter(
        (0.0, 0.0, 0.0), "velocity of the object, as on a belt, world frame", -1.0, 1.0, size=3
    )
    object_turn_rate_deg_s: float = live_parameter(
        0.0, "speed of the object's rotation about its vertical, as on a turntable", -180.0, 180.0
    )
    joint_state_rate_hz: float = parameter(
        125.0, "joint states per second (500 on an e-series)", 10.0, 1000.0
    )
    camera: str = parameter(
        "front",
        "named pose of a fixed camera; each of cameras stands at the one of its own name",
        choices=tuple(CAMERAS),
    )
    image_rate_hz: float = parameter(30.0, "images per second", 1.0, 120.0)
    image_width: int = parameter(640, "image width, pixels", 64, 1920)
    image_height: int = parameter(480, "image height, pixels", 48, 1080)
    dead_time_s: float = parameter(0.008, "delay from command to motion", 0.0, 0.5)
    acceleration_limit_rad_s2: float = parameter(
        15.0, "acceleration limit of the drives", 0.1, 1000.0
    )
    lag_s: float = parameter(0.012, "time constant of the drives", 0.0, 0.5)
    latency_s: float = live_parameter(
        0.04, "time from exposure to the ball position's publication", 0.0, 1.0
    )
    depth_noise: float = live_parameter(
        1.0, "scale of the depth camera's noise; 0: none, 1: like a D435", 0.0, 10.0
    )
    position_noise_m: float = parameter(
        0.0,
        "further white noise on each coordinate of a position (standard deviation), m; on a pose's "
        "rotation as much at a radius of 0.3 m",
        0.0,
        0.1,
    )
    dropout: float = live_parameter(0.0, "share of images that are lost", 0.0, 1.0)
    camera_covered: bool = live_parameter(
        False, "cover the lens: black images without depth, so no ball"
    )
    covered_cameras: tuple[str, ...] = live_parameter(
        (UNNAMED,),
        "names of those of cameras that camera_covered covers; empty: all",
        choices=(UNNAMED, *CAMERAS),
    )
    camera_rotation_deg: tuple[float, ...] = live_parameter(
        (0.0, 0.0, 0.0),
        "rotation of a bumped camera, the first, about its own x, y, z axes, degrees",
        -180.0,
        180.0,
        size=3,
    )
    speed_scaling_percent: float = live_parameter(100.0, "the driver's speed slider", 0.0, 100.0)
    #: Centre of ball or tag beyond the flange.
    ball_offset_m: float = 0.09
    #: How far an object is by default from a camera on the arm at home, and the rotation vector,
    #: rad, by which it does not face it.
    ahead_m: float = 0.35
    aslant_rad: tuple[float, float, float] = (0.31, 0.31, 0.0)
    #: Exposure of an image, in which a tag is blurred by its motion.
    exposure_s: float = 0.005
    #: A whole multiple of ``joint_state_rate_hz``; 0 takes the least one from 500 on.
    physics_rate_hz: float = 0.0
    #: Pose of the first camera in place of a named one, or, in the last link's frame, of that on
    #: the arm.
    camera_pose: RigidPose | None = None
    #: Of each of ``cameras``, in place of ``latency_s`` and ``image_rate_hz``; empty: those.
    latencies_s: tuple[float, ...] = ()
    image_rates_hz: tuple[float, ...] = ()
    #: Whether ball positions come from rendered images. Otherwise they are the true ones (plus
    #: ``position_noise_m``): several times faster, without occlusion and without full frames. With
    #: 0.2 mm of noise the final error is 0.1 mm smaller than with images.
    rendered: bool = True
    #: Gain of a position drive on what is missing.
    position_gain_1_s: float = 10.0
    #: It refuses a position further away than its joint moves in this time.
    position_reach_s: float = 0.5
    #: A further lag of the joints, behind that of the drives.
    joint_lag_s: float = 0.0
    #: Play between a motor, whose angle is reported, and its joint.
    backlash_rad: float = 0.0
    #: A position drive stops this far short of its goal.
    stops_short_rad: float = 0.0
    #: Standard deviation of white noise on each joint angle that is reported, and the steps of an
    #: encoder per turn; 0: infinitely many.
    encoder_noise_rad: float = 0.0
    encoder_steps: int = 0
    #: First distortion coefficient of the first named webcam that sees image points.
    k1: float = -0.2
    #: Relative error, positive for too large, of the reported focal length and of the depths.
    focal_error: float = 0.0
    depth_error: float = 0.0
    objects: tuple[SceneObject, ...] = TABLE

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.physics_rate_hz:
            rate_hz = ceil(500.0 / self.joint_state_rate_hz) * self.joint_state_rate_hz
            object.__setattr__(self, "physics_rate_hz", rate_hz)
        steps = self.physics_rate_hz / self.joint_state_rate_hz
        if abs(steps - round(steps)) > 1e-9 or steps < 1.0:
            raise ValueError(
                f"physics_rate_hz must be a whole multiple of joint_state_rate_hz, got "
                f"{self.physics_rate_hz} and {self.joint_state_rate_hz}"
            )
        if self.image_rate_hz > self.physics_rate_hz:
            raise ValueError(
                f"image_rate_hz {self.image_rate_hz} is above physics_rate_hz "
                f"{self.physics_rate_hz}"
            )
        for name in self.kind.cameras:
            if name and name not in CAMERAS:
                raise ParameterError(f"cameras: {unknown('camera', name, CAMERAS)}")

    def covers(self, camera: str) -> bool:
        """Whether the lens of one of ``cameras`` is covered."""
        return self.camera_covered and bool({UNNAMED, camera} & {*self.covered_cameras})

    def lens(self, camera: str = UNNAMED) -> Intrinsics:
        """Of one of ``cameras``; a webcam has a lens of its own, with its centre anywhere."""
        width, height = self.image_width, self.image_height
        if not self.kind.rigid:
            number = list(CAMERAS).index(camera or self.camera)
            focal = (0.85 + 0.08 * number) * width
            u, v = (0.48 + 0.03 * number) * width, (0.53 - 0.04 * number) * height
            return Lens(width, height, focal, focal, u, v, self.k1 / (1 + number))
        focal = 615.0 / 640.0 * width  # of a D435's colour camera
        return Intrinsics(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))


@dataclass(frozen=True)
class SimNodeConfig(FeatureConfig):
    """Parameters of the node: simulation, publication, and disturbances."""

    simulated_time: bool = parameter(
        False,
        "publish /clock, run as fast as possible and wait for the answers to joint states; the "
        "other nodes then need use_sim_time",
    )
    tf_prefix: str = parameter("", "prefix of the joint names, like a UR driver's")
    full_frame_rate_hz: float = live_parameter(
        30.0,
        "largest rate of full camera images in real time, Hz; each one occupies a core for tens of "
        "milliseconds",
        0.5,
        120.0,
    )
    publish_ball_position: bool = parameter(
        True, "publish the ball position; false: images only, for a detector"
    )
    program_running: bool = live_parameter(
        True, "whether the robot program runs; false: it is paused and the arm stops"
    )
    simulation: SimConfig = field(default_factory=SimConfig)


PARAMETERS = SimNodeConfig.declared()
