"""The simulated robot and camera in lock step: commands in, joint states and ball positions out.

No clock and no ROS: time passes only in :meth:`Simulation.advance`, and the same configuration,
seed and commands give the same results to the bit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np

from fvs_detector_node.detection import BallColour, BallDetection, colour_mask, detect_ball
from fvs_detector_node.tracking import Region, WindowTracker
from fvs_ros.camera import Intrinsics
from fvs_ros.joints import HOME_JOINTS_RAD, N_JOINTS
from fvs_sim_node import kinematics
from fvs_sim_node.actuator import Actuator, ActuatorConfig
from fvs_sim_node.depth_noise import add_depth_noise
from fvs_sim_node.rendering import CameraPose, Renderer, camera_preset
from fvs_sim_node.world import TABLE, SceneObject, World

#: A lost ball is looked for in an image this many times smaller.
_COARSE = 4

#: Parameters of the node that are fields of the configuration.
_SAME_NAME = (
    "seed",
    "gui",
    "urdf_path",
    "ball_link",
    "ball_radius_m",
    "ball_offset_m",
    "physics_rate_hz",
    "joint_state_rate_hz",
    "image_rate_hz",
    "latency_s",
    "depth_noise",
    "position_noise_m",
    "dropout",
    "joint_lag_s",
    "dead_time_s",
    "acceleration_limit_rad_s2",
    "camera",
    "image_width",
    "image_height",
)


#: Fields of the configuration that are attributes of the simulation, too, and may be changed there.
LIVE = (
    "position_noise_m",
    "latency_s",
    "dropout",
    "depth_noise",
    "image_rate_hz",
    "joint_lag_s",
    "dead_time_s",
    "encoder_noise_rad",
    "focal_error",
    "depth_error",
)


@dataclass(frozen=True)
class SimConfig:
    """What is simulated.

    Parameters
    ----------
    seed : int
        Seed of the depth noise and of lost images.
    urdf_path, ball_link : str
        Another UR5 model, and the link that carries the ball; empty for the built-in ones.
    gui : bool
        Whether to open PyBullet's window.
    camera : str
        Name of a camera pose: ``front`` or ``overhead``.
    camera_pose : CameraPose, optional
        An own pose, in place of a named one.
    image_width, image_height : int
        Image size, pixels.
    focal_px : float
        Focal length, pixels; 0 scales a RealSense D435's 615 px at 640 with the width.
    image_rate_hz, physics_rate_hz, joint_state_rate_hz : float
        Rates; the physics must run a whole number of steps per joint state.
    latency_s : float
        From an exposure to the release of its ball position, s.
    ball_radius_m, ball_offset_m : float
        Ball radius, and distance of its centre from the flange on the tool axis, m.
    initial_joints_rad : tuple of float
        Joint angles at the start, rad.
    depth_noise : float
        Factor on the depth camera's noise; 0 for an ideal camera.
    rendered : bool
        Whether ball positions come from rendered images. If not, they are the true ones (plus
        ``position_noise_m``), several times faster, and nothing hides the ball but the image's
        border; full frames are then not to be had. With noise of 1 mm an arm comes to rest alike;
        with 0.2 mm it rests 0.1 mm nearer, as the detection's own deviation stands still with it.
    position_noise_m : float
        Standard deviation of a further, white noise on each coordinate of a ball position, m.
    dropout : float
        Probability that an image is lost.
    dead_time_s, acceleration_limit_rad_s2, lag_s : float
        The drives; see :class:`~fvs_sim_node.actuator.ActuatorConfig`.
    joint_lag_s : float
        Further lag of the joints, s.
    encoder_noise_rad : float
        Standard deviation of white noise on each joint angle that is told, rad.
    focal_error, depth_error : float
        By what share the camera is told a longer focal length than it has, and tells larger depths.
    colour : BallColour
        What the detection takes for the ball's colour.
    objects : tuple of SceneObject
        What else is in view.
    """

    seed: int = 0
    urdf_path: str = ""
    ball_link: str = ""
    gui: bool = False
    camera: str = "front"
    camera_pose: CameraPose | None = None
    image_width: int = 640
    image_height: int = 480
    focal_px: float = 0.0
    image_rate_hz: float = 30.0
    physics_rate_hz: float = 500.0
    joint_state_rate_hz: float = 125.0
    latency_s: float = 0.04
    ball_radius_m: float = 0.04
    ball_offset_m: float = 0.09
    initial_joints_rad: tuple[float, ...] = HOME_JOINTS_RAD
    depth_noise: float = 1.0
    rendered: bool = True
    position_noise_m: float = 0.0
    dropout: float = 0.0
    dead_time_s: float = 0.008
    acceleration_limit_rad_s2: float = 15.0
    lag_s: float = 0.012
    joint_lag_s: float = 0.0
    encoder_noise_rad: float = 0.0
    focal_error: float = 0.0
    depth_error: float = 0.0
    colour: BallColour = field(default_factory=BallColour)
    objects: tuple[SceneObject, ...] = TABLE

    def __post_init__(self) -> None:
        for name in ("image_rate_hz", "physics_rate_hz", "joint_state_rate_hz"):
            if getattr(self, name) <= 0.0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
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
        if len(self.initial_joints_rad) != N_JOINTS:
            raise ValueError(
                f"initial_joints_rad must have {N_JOINTS} angles, got {self.initial_joints_rad}"
            )
        if not (np.isfinite(self.position_noise_m) and self.position_noise_m >= 0.0):
            raise ValueError(f"position_noise_m must not be negative, got {self.position_noise_m}")
        if self.ball_radius_m <= 0.0:
            raise ValueError(f"ball_radius_m must be positive, got {self.ball_radius_m}")

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> SimConfig:
        """The configuration that a node's parameter values describe."""
        return cls(
            **{name: values[name] for name in _SAME_NAME},
            initial_joints_rad=tuple(values["initial_joints_rad"]),
            focal_px=values["focal_length_px"],
            lag_s=values["drive_lag_s"],
        )

    @property
    def intrinsics(self) -> Intrinsics:
        """The camera's."""
        focal = self.focal_px or 615.0 * self.image_width / 640.0
        return Intrinsics(
            self.image_width,
            self.image_height,
            focal,
            focal,
            0.5 * (self.image_width - 1),
            0.5 * (self.image_height - 1),
        )


def build_world(config: SimConfig, gui: bool = False) -> World:
    """The scene of a configuration."""
    return World(
        urdf_path=config.urdf_path,
        ball_link=config.ball_link,
        ball_radius_m=config.ball_radius_m,
        ball_offset_m=config.ball_offset_m,
        physics_rate_hz=config.physics_rate_hz,
        gui=gui,
        objects=config.objects,
    )


@dataclass(frozen=True)
class Frame:
    """A full image with its noisy depth.

    Parameters
    ----------
    stamp_s : float
        Exposure, s.
    rgb : ndarray of uint8, shape (H, W, 3)
        Colours.
    depth_m : ndarray of float32, shape (H, W)
        Depth along the optical axis, m; 0 where there is none.
    """

    stamp_s: float
    rgb: np.ndarray
    depth_m: np.ndarray

    @classmethod
    def black(cls, stamp_s: float, intrinsics: Intrinsics) -> Frame:
        """What a covered lens gives at an exposure, s: no light, no depth."""
        shape = (intrinsics.height, intrinsics.width)
        return cls(stamp_s, np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.float32))


@dataclass(frozen=True)
class BallObservation:
    """What one image gave.

    Parameters
    ----------
    stamp_s : float
        Exposure, s.
    detection : BallDetection or None
        The ball as detected in the image; None if it was not seen.
    true_position_m : ndarray, shape (3,)
        Where it was, camera frame, m. For evaluation only.
    joints_rad : ndarray, shape (6,)
        Joint angles at the exposure, rad.
    camera : CameraPose
        Where the camera was.
    frame : Frame or None
        The image, if full frames are wanted.
    covered : bool
        Whether the lens was covered.
    """

    stamp_s: float
    detection: BallDetection | None
    true_position_m: np.ndarray
    joints_rad: np.ndarray
    camera: CameraPose
    frame: Frame | None
    covered: bool = False


@dataclass(frozen=True)
class SimStep:
    """The world after one joint-state period.

    Parameters
    ----------
    time_s : float
        Simulated time, s.
    joints_rad, joint_velocities_rad_s : ndarray, shape (6,)
        Joint angles, as the encoders tell them, and velocities now, kinematic order.
    observations : tuple of BallObservation
        Those that were released during this period.
    """

    time_s: float
    joints_rad: np.ndarray
    joint_velocities_rad_s: np.ndarray
    observations: tuple[BallObservation, ...]


class Simulation:
    """A UR5 with a ball on its end, seen by a depth camera.

    Parameters
    ----------
    config : SimConfig, optional
        What is simulated.

    Attributes
    ----------
    position_noise_m, latency_s, dropout, depth_noise, dead_time_s, joint_lag_s : float
        Live values of those in the configuration.
    encoder_noise_rad, focal_error, depth_error : float
        Live, too.
    image_rate_hz : float
        That of the configuration; another value counts from the next reset on.
    position_noise : callable, optional
        Draws the error of a ball position, m, shape (3,), from the run's random generator, in
        place of the white noise of the configuration.
    full_frames : bool
        Whether to draw whole images and hand them out; slower, and with other random numbers.
    covered : bool
        Whether the lens is covered: images are black, and no ball is seen.
    camera : CameraPose
        Where the camera is now.
    """

    position_noise_m: float
    latency_s: float
    dropout: float
    depth_noise: float
    image_rate_hz: float
    encoder_noise_rad: float
    focal_error: float
    depth_error: float

    def __init__(self, config: SimConfig | None = None) -> None:
        cv2.setNumThreads(1)  # one small image at a time: threads only cost
        self.config = config or SimConfig()
        cfg = self.config
        self.intrinsics = cfg.intrinsics
        self.world = build_world(cfg, gui=cfg.gui)
        self._renderer = Renderer(self.world.client, self.intrinsics)
        self._actuator = Actuator(
            ActuatorConfig(
                control_period_s=1.0 / cfg.joint_state_rate_hz,
                dead_time_s=cfg.dead_time_s,
                acceleration_limit_rad_s2=cfg.acceleration_limit_rad_s2,
                lag_s=cfg.lag_s,
            ),
            1.0 / cfg.physics_rate_hz,
            self.world.lower_rad,
            self.world.upper_rad,
        )
        self._steps_per_period = round(cfg.physics_rate_hz / cfg.joint_state_rate_hz)
        self.camera = cfg.camera_pose or camera_preset(cfg.camera)
        for name in LIVE:
            setattr(self, name, getattr(cfg, name))
        self.position_noise: Callable[[np.random.Generator], np.ndarray] | None = None
        self.full_frames = False
        self.covered = False
        self.reset()

    def close(self) -> None:
        """Free the physics engine."""
        self.world.close()

    def __enter__(self) -> Simulation:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    # ------------------------------------------------------------------ running
    @property
    def time_s(self) -> float:
        """Simulated time, s."""
        return self._step / self.config.physics_rate_hz

    def reset(
        self, joints_rad: Sequence[float] | np.ndarray | None = None, seed: int | None = None
    ) -> None:
        """Start again at time 0 with the seed's noise, at rest.

        Disturbances that were set (camera, latency, noise, losses, lag, scaling, cover) stay.

        Parameters
        ----------
        joints_rad : array_like, shape (6,), optional
            Joint angles, rad; default those of the configuration.
        seed : int, optional
            Seed of this run's noise and lost images; default that of the configuration.
        """
        joints = np.array(
            self.config.initial_joints_rad if joints_rad is None else joints_rad, dtype=float
        )
        if joints.shape != (N_JOINTS,) or not np.isfinite(joints).all():
            raise ValueError(f"reset needs {N_JOINTS} finite joint angles, got {joints_rad}")
        seeds = np.random.SeedSequence(self.config.seed if seed is None else seed).spawn(3)
        self._noise_rng, self._loss_rng, self._encoder_rng = map(np.random.default_rng, seeds)
        self._step = 0
        self._image_count = 0
        self._active = True
        self._pending: deque[tuple[float, BallObservation]] = deque()
        self._tracker = WindowTracker(self._told_intrinsics, self.config.ball_radius_m)
        self._actuator.reset()
        self.world.reset(joints)
        self._joints, self._velocities = self.world.joint_states()

    def command(self, velocity_rad_s: Sequence[float] | np.ndarray) -> str | None:
        """Command joint velocities, as ``forward_velocity_controller`` takes them.

        The command holds until the next one, for ever if none comes.

        Parameters
        ----------
        velocity_rad_s : array_like
            Six velocities, rad/s, kinematic order.

        Returns
        -------
        str or None
            None if it was taken, else why not. As with ros2_controllers' ``jazzy`` branch, a
            value that is not finite drops the whole message, and a wrong number of values
            deactivates the controller: the arm stops until :meth:`activate`.
        """
        velocity = np.asarray(velocity_rad_s, dtype=float).ravel()
        if not self._active:
            return "the velocity controller is inactive and takes no command; activate it first"
        if velocity.size == 0:
            return "an empty command was ignored; the last one goes on"
        if velocity.size != N_JOINTS:
            self.deactivate()
            return (
                f"a command of {velocity.size} values deactivated the velocity controller; "
                f"it takes {N_JOINTS}"
            )
        if not np.isfinite(velocity).all():
            return "a command that is not finite was dropped; the last one goes on"
        self._actuator.command(velocity)
        return None

    @property
    def active(self) -> bool:
        """Whether the velocity controller takes commands."""
        return self._active

    def deactivate(self) -> None:
        """Deactivate the velocity controller: its command is gone, and it takes none."""
        self._active = False
        self._actuator.command(np.zeros(N_JOINTS))

    def activate(self) -> None:
        """Activate the velocity controller again, at a zero command."""
        if not self._active:
            self._active = True
            self._actuator.command(np.zeros(N_JOINTS))

    def advance(self) -> SimStep:
        """Advance by one joint-state period.

        Returns
        -------
        SimStep
            Joint state at its end, and the observations released in it.
        """
        if self._step == 0:
            self._expose_if_due()
        for _ in range(self._steps_per_period):
            self.world.drive(self._actuator.step(self._joints))
            self.world.step()
            self._joints, self._velocities = self.world.joint_states()
            self._step += 1
            self._expose_if_due()
        now = self.time_s
        released = []
        while self._pending and self._pending[0][0] <= now + 1e-9:
            released.append(self._pending.popleft()[1])
        told = self._joints + self._encoder_rng.normal(scale=self.encoder_noise_rad, size=N_JOINTS)
        return SimStep(now, told, self._velocities.copy(), tuple(released))

    # --------------------------------------------------------------------- eyes
    def _expose_if_due(self) -> None:
        cfg = self.config
        due = int(np.floor(self._image_count * cfg.physics_rate_hz / self.image_rate_hz + 0.5))
        if self._step < due:
            return
        self._image_count += 1
        if self._loss_rng.random() < self.dropout:
            return
        observation = self._look()
        self._pending.append((self.time_s + self.latency_s, observation))

    def look(self) -> BallObservation:
        """Expose an image now, for one's own use: nothing is released for it."""
        return self._look()

    @property
    def joints_rad(self) -> np.ndarray:
        """Joint angles now, rad, shape (6,); a copy."""
        return self._joints.copy()

    def _look(self) -> BallObservation:
        if self.covered:
            self._tracker.update(self.time_s, None)
            black = Frame.black(self.time_s, self.intrinsics) if self.full_frames else None
            return self._observe(None, black)
        if not self.config.rendered:
            return self._observe(self._know())
        self.world.place_ball()
        stamp = self.time_s
        whole = self._draw(self._renderer.full) if self.full_frames else None
        detection = None
        for region in self._regions(stamp, whole is not None):
            image = self._draw(region) if whole is None else _crop(whole, region)
            detection = self._detect(image, region)
            if detection is not None and not region.cuts_off(detection, self.intrinsics):
                break
        self._tracker.update(stamp, detection)
        frame = None if whole is None else Frame(stamp, *whole)
        if detection is not None:
            detection = replace(detection, position_m=self._blurred(detection.position_m))
        return self._observe(detection, frame)

    def _observe(
        self, detection: BallDetection | None, frame: Frame | None = None
    ) -> BallObservation:
        return BallObservation(
            self.time_s,
            detection,
            self.true_ball_position(),
            self._joints.copy(),
            self.camera,
            frame,
            self.covered,
        )

    def _know(self) -> BallDetection | None:
        """Stand in for an image: the true position, as if detected without a flaw."""
        position = self.true_ball_position()
        if position[2] < 2.0 * self.config.ball_radius_m:
            return None
        u, v = self.intrinsics.project(position)
        if not (0.0 <= u < self.intrinsics.width and 0.0 <= v < self.intrinsics.height):
            return None
        radius_px = self.config.ball_radius_m * self.intrinsics.fx / position[2]
        seen = self._blurred(self.as_seen(position))
        return BallDetection(seen, 1.0, 1.0, 0.0, (float(u), float(v)), float(radius_px))

    def _blurred(self, position_m: np.ndarray) -> np.ndarray:
        if self.position_noise is not None:
            return position_m + self.position_noise(self._noise_rng)
        if self.position_noise_m == 0.0:
            return position_m
        return position_m + self._noise_rng.normal(scale=self.position_noise_m, size=3)

    def _regions(self, stamp_s: float, has_whole: bool) -> Iterator[Region]:
        """Parts of the image to look at, one after the other until the ball is found."""
        expected = self._tracker.region(stamp_s)
        if expected is not None:
            yield expected
        if has_whole:
            yield self._renderer.full
        else:
            coloured = self._search()
            if coloured is not None:
                yield coloured

    def _search(self) -> Region | None:
        """Find the part of the image that holds all of the ball's colour, in a coarse image."""
        rgb = self._renderer.render_coarse(self.camera, _COARSE)
        u, v, width, height = cv2.boundingRect(colour_mask(rgb, self.config.colour))
        if width == 0:
            return None
        margin = 4
        u0, v0 = max(0, (u - margin) * _COARSE), max(0, (v - margin) * _COARSE)
        u1 = min(self.intrinsics.width, (u + width + margin) * _COARSE)
        v1 = min(self.intrinsics.height, (v + height + margin) * _COARSE)
        return Region(u0, v0, u1 - u0, v1 - v0)

    def _draw(self, region: Region) -> tuple[np.ndarray, np.ndarray]:
        rgb, depth = self._renderer.render(self.camera, region)
        noisy = add_depth_noise(depth, self.intrinsics.fx, self._noise_rng, self.depth_noise)
        return rgb, noisy * np.float32(1.0 + self.depth_error)

    def _detect(self, image: tuple[np.ndarray, np.ndarray], region: Region) -> BallDetection | None:
        told = self._told_intrinsics
        window = told.window(region.u0, region.v0, region.width, region.height)
        detection = detect_ball(*image, window, self.config.ball_radius_m, self.config.colour)
        if detection is None:
            return None
        u, v = detection.pixel
        return replace(detection, pixel=(u + region.u0, v + region.v0))

    @property
    def _told_intrinsics(self) -> Intrinsics:
        """What the detection takes for the camera's."""
        one, scale = self.intrinsics, 1.0 + self.focal_error
        return replace(one, fx=scale * one.fx, fy=scale * one.fy)

    # -------------------------------------------------------------------- truth
    def as_seen(self, position_m: np.ndarray) -> np.ndarray:
        """Where a camera with these errors sees what is at a position of its frame, m, (3,).

        A ball in a rendered image is up to 2 mm from there (at 2 %): it looks larger or smaller
        than its distance says.
        """
        x, y, z = (1.0 + self.depth_error) * position_m
        return np.array([x / (1.0 + self.focal_error), y / (1.0 + self.focal_error), z])

    def true_ball_position(self) -> np.ndarray:
        """Where the ball is now, camera frame, m, shape (3,). For evaluation only."""
        return self.camera.to_camera(self.world.ball_position())

    def true_jacobian(self, joints_rad: Sequence[float] | np.ndarray) -> np.ndarray:
        """Exact Jacobian of the ball's position in the camera frame.

        Parameters
        ----------
        joints_rad : array_like, shape (6,)
            Joint angles, rad.

        Returns
        -------
        ndarray, shape (3, 6)
            m/rad. In closed form for the built-in arm, from the physics engine for another.
        """
        joints = np.asarray(joints_rad, dtype=float)
        if self.config.urdf_path or self.world.ball_link != "tool0":
            jacobian = self.world.ball_jacobian(joints)
        else:
            jacobian = kinematics.ball_jacobian(joints, self.config.ball_offset_m)
        return self.camera.rotation.T @ jacobian

    # ------------------------------------------------------------- disturbances
    @property
    def dead_time_s(self) -> float:
        """Time from a command to its first effect, s."""
        return self._actuator.dead_time_s

    @dead_time_s.setter
    def dead_time_s(self, value: float) -> None:
        self._actuator.dead_time_s = value

    @property
    def joint_lag_s(self) -> float:
        """Further first-order lag of the joints, s."""
        return self._actuator.joint_lag_s

    @joint_lag_s.setter
    def joint_lag_s(self, value: float) -> None:
        if not value >= 0.0:
            raise ValueError(f"joint_lag_s must not be negative, got {value}")
        self._actuator.joint_lag_s = float(value)

    @property
    def speed_scaling(self) -> float:
        """Factor on every commanded velocity, 0 to 1."""
        return self._actuator.speed_scaling

    @speed_scaling.setter
    def speed_scaling(self, value: float) -> None:
        if not 0.0 <= value <= 1.0:
            raise ValueError(f"speed_scaling must be 0 to 1, got {value}")
        self._actuator.speed_scaling = float(value)

    def rotate_camera(self, rotation_rad: Sequence[float] | np.ndarray) -> None:
        """Bump the camera: turn it about its own centre.

        Parameters
        ----------
        rotation_rad : array_like, shape (3,)
            Rotation vector in the camera frame: axis times angle, rad.
        """
        vector = np.asarray(rotation_rad, dtype=float).reshape(3, 1)
        self.camera = self.camera.rotated(cv2.Rodrigues(vector)[0])

    def move_camera(self, translation_m: Sequence[float] | np.ndarray) -> None:
        """Move the camera by a vector in the world frame, m, shape (3,)."""
        position = self.camera.position_m + np.asarray(translation_m, dtype=float)
        self.camera = CameraPose(position, self.camera.rotation)


def _crop(image: tuple[np.ndarray, np.ndarray], part: Region) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = slice(part.v0, part.v0 + part.height), slice(part.u0, part.u0 + part.width)
    return image[0][rows, columns], image[1][rows, columns]
