"""The simulated robot and camera in lock step: commands in, joint states and detections out.

It uses no clock and no ROS: time passes only in :meth:`Simulation.advance`. The same configuration,
seed and commands give bit-identical results.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from fvs_detector_node.config import DetectorConfig
from fvs_detector_node.detector import Detector
from fvs_detector_node.detectors import make_detector, make_object_detector
from fvs_detector_node.images import Region
from fvs_ros.camera import CameraModel, Intrinsics
from fvs_ros.interface import VELOCITY
from fvs_ros.kinds import Kind
from fvs_ros.pixel_chain import PixelChain, PixelChains
from fvs_sim_node.actuator import Actuator
from fvs_sim_node.camera import Lens, RigidPose
from fvs_sim_node.carried import Carried
from fvs_sim_node.config import SimConfig
from fvs_sim_node.world import World


@dataclass(frozen=True)
class Observation:
    """The result of one image; its true values are for evaluation only."""

    stamp_s: float  # exposure
    z: np.ndarray | None  # what is reported of what is servoed, with noise, (m,); None if not seen
    visible_fraction: float  # of it
    true_position_m: np.ndarray  # of its middle, camera frame, (3,)
    joints_rad: np.ndarray  # at the exposure, (n,)
    velocities_rad_s: np.ndarray  # of the joints then, (n,)
    camera: RigidPose  # world frame
    number: int  # of the camera
    object_z: np.ndarray | None  # as z, of the object
    object_pose: RigidPose  # the true one, world frame
    frame: tuple[np.ndarray, np.ndarray] | None = None  # colours and depths, if they are wanted


@dataclass(frozen=True)
class SimStep:
    """The world after one joint-state period; joints in kinematic order, shape (n,)."""

    time_s: float
    joints_rad: np.ndarray  # as the encoders report them
    joint_velocities_rad_s: np.ndarray
    observations: tuple[Observation, ...]  # those that were released during this period


@dataclass
class View:
    """One of the cameras of a simulation, and its own noise and lost images."""

    number: int
    kind: Kind  # of what it measures
    lens: Intrinsics
    detector: Detector
    object_detector: Detector | None
    #: The camera's pose in the room, or in the frame of the arm's last link.
    mounted: RigidPose

    def reset(self, *rngs: np.random.Generator) -> None:
        """Begin again with these generators."""
        self.noise_rng, self.loss_rng, _, self.frame_rng, self.object_rng = rngs
        self.image_count = 0
        self.pending: deque[tuple[float, Observation]] = deque()
        for detector in filter(None, (self.detector, self.object_detector)):
            detector.reset()


class Simulation:
    """An arm with a ball on its end, seen by cameras; or with the camera on its end."""

    def __init__(self, config: SimConfig | None = None) -> None:
        config = config or SimConfig()
        self.kind = config.kind  #: of what is servoed
        self.world = World(config)
        self._actuator = Actuator(
            config, self.world.lower_rad, self.world.upper_rad, self.world.max_speed_rad_s
        )
        self._steps_per_period = round(config.physics_rate_hz / config.joint_state_rate_hz)
        #: Draws the error of a ball position, m, (3,), by the generator, in place of white noise.
        self.position_noise: Callable[[np.random.Generator], np.ndarray] | None = None
        self.full_frames = False  #: whether observations include full images; slower
        own = {member.name for member in fields(DetectorConfig)} & vars(config).keys()
        detection = DetectorConfig(**{name: getattr(config, name) for name in own})
        self.views = [  #: the cameras: several webcams, or one
            View(
                number,
                part,
                config.lens(part.cameras[0]),
                make_detector(detection),
                make_object_detector(detection),
                self.world.camera_home(config, number),
            )
            for number, part in enumerate(self.kind.parts)
        ]
        self.configure(config)
        self.reset()

    def configure(self, config: SimConfig) -> None:
        """Take another configuration into use.

        Drives, noise, losses, latency, the object's speeds and the camera's pose and cover change
        at once; the image rate, ``focal_error``, seed, initial joints and the object's place from
        the next reset on. The robot, the scene and the other rates are those of the first
        configuration.
        """
        self.config = self._actuator.config = config
        home = self.world.camera_home(config)
        self.views[0].mounted = home.rotated(np.radians(config.camera_rotation_deg))

    @property
    def camera(self) -> RigidPose:
        """Where the first camera is now, world frame; it may be set."""
        return self._pose(self.views[0])

    @camera.setter
    def camera(self, pose: RigidPose) -> None:
        own = self.world.link().pose_to_own(pose) if self.kind.on_arm else pose
        self.views[0].mounted = own

    def _pose(self, view: View) -> RigidPose:
        """Where a camera is now, world frame."""
        return self.world.link().pose_from_own(view.mounted) if self.kind.on_arm else view.mounted

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

    @property
    def joints_rad(self) -> np.ndarray:
        """Joint angles now, rad, shape (n,); a copy."""
        return self._joints.copy()

    def reset(
        self, joints_rad: Sequence[float] | np.ndarray | None = None, seed: int | None = None
    ) -> None:
        """Start again at time 0 with the seed's noise, at rest, the object in its place.

        The camera stays where it is mounted.

        Parameters
        ----------
        joints_rad : array_like, shape (n,), optional
            Joint angles, rad; default those of the configuration.
        seed : int, optional
            Seed of this run's noise and lost images; default that of the configuration.
        """
        config = self.config
        joints = self.world.start_rad(config, joints_rad)
        source = np.random.SeedSequence(config.seed if seed is None else seed)
        seeds = [source.spawn(5)]
        self._encoder_rng = np.random.default_rng(seeds[0][2])
        seeds += [each.spawn(5) for each in source.spawn(len(self.views) - 1)]
        for view, own in zip(self.views, seeds, strict=True):
            view.reset(*map(np.random.default_rng, own))
        self._step = 0
        self.active = True  #: whether the velocity controller takes commands
        #: Position commands: the newest, and the one before.
        self._wanted: np.ndarray | None = None
        self._sought: np.ndarray | None = None
        self.place_object()
        self._actuator.reset()
        self.world.reset(joints)
        self._joints, self._velocities = self.world.joint_states()

    def place_object(self) -> None:
        """Put the object where the configuration has it."""
        self.world.object_pose = self.world.placed_object(self.config)

    def command(self, values: Sequence[float] | np.ndarray) -> str | None:
        """Command the joints, as ``forward_velocity_controller`` takes it.

        The command holds until the next one, for ever if none comes.

        Parameters
        ----------
        values : array_like, shape (n,)
            Velocities, rad/s, or, by ``command_interface``, positions, rad; kinematic order.

        Returns
        -------
        str or None
            None if it was taken, else why not. As with ros2_controllers' ``jazzy`` branch, a
            value that is not finite drops the whole message, and a wrong number of values
            deactivates the controller: the arm stops until ``active`` is set.
        """
        command = np.asarray(values, dtype=float).ravel()
        refusal = self._refusal(command)
        if refusal is None and self.config.command_interface == VELOCITY:
            self._actuator.command(command)
        elif refusal is None:
            self._wanted = command
        return refusal

    def _refusal(self, command: np.ndarray) -> str | None:
        interface, joints = self.config.command_interface, self._joints
        if not self.active:
            return f"the {interface} controller is inactive and takes no command; activate it first"
        if command.size == 0:
            return "an empty command was ignored; the last one goes on"
        if command.size != joints.size:
            self.deactivate()
            return (
                f"a command of {command.size} values deactivated the {interface} controller; "
                f"it takes {joints.size}"
            )
        if not np.isfinite(command).all():
            return "a command that is not finite was dropped; the last one goes on"
        steps = np.zeros(1) if interface == VELOCITY else np.abs(command - joints)
        if (steps > self.config.position_reach_s * self.world.max_speed_rad_s).any():
            return f"a position that is {steps.max():.2f} rad away from its joint was refused"
        return None

    def deactivate(self) -> None:
        """Deactivate the controller: its command is gone, and it takes none."""
        self.active = False
        self._wanted = self._sought = None
        self._actuator.command(np.zeros(self._joints.size))

    def _seek(self) -> None:
        """Follow the position command: its own speed, and a gain on what is missing."""
        if self._wanted is None:
            return
        before = self._wanted if self._sought is None else self._sought
        speed = (self._wanted - before) * self.config.joint_state_rate_hz
        missing, short = before - self._encoders(), self.config.stops_short_rad
        if short:
            speed = np.where(np.abs(missing) > short, speed, 0.0)
            missing -= np.clip(missing, -short, short)
        self._actuator.command(speed + self.config.position_gain_1_s * missing)
        self._sought = self._wanted

    def _encoders(self) -> np.ndarray:
        """The motors' angles, in the steps of their encoders, rad, (n,)."""
        angles, steps = self._joints + self._actuator.play_rad, self.config.encoder_steps
        if steps:
            angles = np.round(angles * (steps / (2.0 * np.pi))) * (2.0 * np.pi / steps)
        return angles

    def advance(self) -> SimStep:
        """Advance by one joint-state period."""
        if self._step == 0:
            self._expose_if_due()
        self._seek()
        for _ in range(self._steps_per_period):
            self.world.drive(self._actuator.step(self._joints))
            self.world.step()
            self._joints, self._velocities = self.world.joint_states()
            self._step += 1
            self.world.move_object(self.config, 1.0 / self.config.physics_rate_hz)
            self._expose_if_due()
        now_s = self.time_s
        released = []
        for view in self.views:
            while view.pending and view.pending[0][0] <= now_s + 1e-9:
                released.append(view.pending.popleft()[1])
        deviation_rad = self.config.encoder_noise_rad
        noise = self._encoder_rng.normal(scale=deviation_rad, size=self._joints.size)
        return SimStep(now_s, self._encoders() + noise, self._velocities.copy(), tuple(released))

    # --------------------------------------------------------------------- eyes
    def _expose_if_due(self) -> None:
        config, count = self.config, len(self.views)
        for view in self.views:
            number = view.number
            rate_hz = (config.image_rates_hz or count * (config.image_rate_hz,))[number]
            latency_s = (config.latencies_s or count * (config.latency_s,))[number]
            every = config.physics_rate_hz / rate_hz
            # Webcams are not synchronized: their exposures are spread.
            if self._step < int(np.floor((view.image_count + number / count) * every + 0.5)):
                continue
            view.image_count += 1
            if view.loss_rng.random() >= config.dropout:
                view.pending.append((self.time_s + latency_s, self.look(number)))

    def look(self, number: int = 0) -> Observation:
        """Expose an image of a camera now; nothing is released for it."""
        if self.config.rendered or self.full_frames:
            self.world.place_bodies()
        world, view, object_z = self.world, self.views[number], None
        camera = self._pose(view)
        true = camera.pose_to_own(world.feature_pose())
        z, visible_fraction = self._measured(view, world.body, true, view.detector, view.noise_rng)
        if world.object is not None and view.object_detector is not None:
            pose = camera.pose_to_own(world.object_pose)
            object_z, _ = self._measured(
                view, world.object, pose, view.object_detector, view.object_rng
            )
        return Observation(
            self.time_s,
            z,
            visible_fraction,
            true.position_m,
            self.joints_rad,
            self._velocities,
            camera,
            number,
            object_z,
            world.object_pose,
            self._photograph(view, view.frame_rng) if self.full_frames else None,
        )

    def _photograph(
        self, view: View, rng: np.random.Generator, region: Region | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        return self.world.photograph(
            self.config, self._pose(view), self._velocities, rng, region, view.number
        )

    def _measured(
        self,
        view: View,
        body: Carried,
        true: RigidPose,
        detector: Detector,
        rng: np.random.Generator,
    ) -> tuple[np.ndarray | None, float]:
        """What is reported of a body now, None if it is not seen, and its visible fraction."""
        camera, kind = view.lens, view.kind
        part = None if self.config.covers(kind.cameras[0]) else body.part(true, camera)
        if part is None:
            return None, 0.0
        if not self.config.rendered:
            z, fraction = _feature(view, body, true), 1.0
            points_px = camera.project(true.position_m) if kind.rigid else z.reshape(-1, 2)
            in_view = camera.contains(points_px)
            if not in_view or (kind.on_arm and not body.legible(true, camera)):
                return None, 0.0
            z = self.as_seen(z) if kind.rigid else z
        else:
            # As from a camera that sends only the region around the body: drawing takes long.
            region = part.grown(min(part.width // 8 + 8, 24), camera)
            model = CameraModel(region.view(self.reported_intrinsics))
            images = self._photograph(view, rng, region)
            detection = detector.detect(self.time_s, *images, model).detection
            if detection is None:
                return None, 0.0
            z = kind.of_detection(detection)
            fraction = detection.visible_fraction
        return self._blurred(kind, z, rng), fraction

    def _blurred(self, kind: Kind, z: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """The measurement with further noise, of a rotation along its arc."""
        deviation_m = self.config.position_noise_m
        if self.position_noise is None and deviation_m == 0.0:
            return z
        noise_m = np.zeros(kind.size)
        if self.position_noise is not None:
            noise_m[:3] = self.position_noise(rng)
        else:
            noise_m += rng.normal(scale=deviation_m, size=noise_m.size)
        return kind.retract(z, noise_m)

    @property
    def reported_intrinsics(self) -> Intrinsics:
        """The intrinsics that ``camera_info`` and the detection have, with ``focal_error``."""
        true, scale = self.views[0].lens, 1.0 + self.config.focal_error
        if not self.kind.rigid:
            return Intrinsics.of_pixels(true.width, true.height)  # nothing is known
        return replace(true, fx=scale * true.fx, fy=scale * true.fy)

    # -------------------------------------------------------------------- truth
    def as_seen(self, z: np.ndarray) -> np.ndarray:
        """What a camera with these errors reports for a true measurement, (m,).

        For a ball in a rendered image this is accurate to 2 mm (at 2 %), because the ball's size in
        the image does not match its distance.
        """
        if not self.kind.rigid:
            return z  # no lens is known that could be wrong
        scaled = np.append((1.0 + self.config.depth_error) * z[:3], z[3:])
        return self.kind.without_lens(scaled[None], self.config.focal_error, 0.0)[0]

    def true_pose(self) -> RigidPose:
        """What is servoed as the first camera sees it now. For evaluation only."""
        return self.camera.pose_to_own(self.world.feature_pose())

    def true_feature(self) -> np.ndarray:
        """The feature as the cameras see it now, (m,). For evaluation only."""
        world, body = self.world.feature_pose(), self.world.body
        poses = [self._pose(view).pose_to_own(world) for view in self.views]
        return np.concatenate(
            [_feature(view, body, pose) for view, pose in zip(self.views, poses, strict=True)]
        )

    def true_object(self) -> np.ndarray | None:
        """The object's feature beside the tool's as the camera sees it now. For evaluation only."""
        if self.views[0].object_detector is None:
            return None
        pose = self.camera.pose_to_own(self.world.object_pose)
        return self.kind.of_body(pose.position_m, pose.rotation)

    def true_jacobian(
        self, joints_rad: Sequence[float] | np.ndarray, kind: Kind | None = None
    ) -> np.ndarray:
        """Exact Jacobian of the feature, m/rad, shape (d, n), camera frame.

        Parameters
        ----------
        joints_rad : array_like, shape (n,)
            Joint angles, rad.
        kind : Kind, optional
            Of the feature; default that of the configuration.
        """
        kind = kind or self.kind
        return kind.along(self.true_chain(kind), np.asarray(joints_rad, dtype=float))[1]

    def true_chain(self, kind: Kind | None = None) -> Any:
        """The arm, or its pixels, as the cameras see it now, for evaluation only.

        Of a body, as the first one sees it.
        """
        kind, chains = kind or self.kind, []
        chain = self.world.chain_with(kind)
        if self.kind.on_arm:
            pose = self.world.object_pose
            seen = kind.of_body(pose.position_m, pose.rotation)
            chain = replace(chain, feature_m=seen, on_arm=True)
        for view in self.views:
            camera = view.mounted
            if self.kind.on_arm:
                camera = self.world.zero_link.pose_from_own(camera)
            back, lens = camera.rotation.T, view.lens
            own: Any = chain.moved(back, -back @ camera.position_m)
            if isinstance(lens, Lens) and not kind.rigid:
                own = PixelChain(own, lens.webcam)
            chains.append(own)
        return chains[0] if kind.rigid else PixelChains(tuple(chains))


def _feature(view: View, body: Carried, pose: RigidPose) -> np.ndarray:
    """Of a body at a pose in a camera's frame, (m,)."""
    if view.kind.rigid:
        return view.kind.of_body(pose.position_m, pose.rotation)
    return view.lens.project(body.points_m @ pose.rotation.T + pose.position_m).ravel()
