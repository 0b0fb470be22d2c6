"""The PyBullet world: the arm, what it carries, what stands in the room, and the renderer.

Every world is its own client, so that one process can hold several.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from math import ceil
from tempfile import NamedTemporaryFile
from typing import Any

import cv2
import numpy as np

from fvs_detector_node.images import Region
from fvs_ros.camera import Intrinsics
from fvs_ros.chain import SerialChain
from fvs_ros.kinds import Kind
from fvs_ros.kinds.ball import Ball
from fvs_ros.kinds.kind import ON_ARM
from fvs_ros.rotations import quaternion_from_rotation, rotation_from_vector
from fvs_ros.urdf import UrdfJoint
from fvs_sim_node.camera import BRACKET, D435, Lens, RigidPose, add_depth_noise
from fvs_sim_node.carried import CARRIED, Carried, CarriedTag, exposed
from fvs_sim_node.config import SimConfig
from fvs_sim_node.placement import Placement
from fvs_sim_node.robot import moving_joints, robot_description, robot_of
from fvs_sim_node.shapes import BulletClient, box, pybullet, sphere, without_chatter

#: Depth range that is drawn, m; for a camera on the arm, from nearer on. What lies beyond has no
#: depth, as with a real camera.
_NEAR_M, _FAR_M = 0.25, 4.0
# OpenGL cameras look along -z with y up.
_OPTICAL_TO_GL = np.diag([1.0, -1.0, -1.0])


class World:
    """An arm with driven joints and a ball or a camera on its end.

    The world frame is that of the URDF's root link. Gravity is off, since an arm's controller
    compensates it. ``client`` has PyBullet's functions for this world; ``joint_names`` are the
    moving joints from the root to the last link, with their limits, shape (n,). ``body`` is
    servoed, and hangs on the arm unless the camera does; ``object``, if there is one, stands in the
    room at ``object_pose``, world frame, which may be set. The cameras are mounted in the frame of
    ``camera_link``; ``renderers`` are theirs.

    A ``ValueError`` says that the URDF cannot be loaded, or lacks the link or joints that move it.
    """

    def __init__(self, config: SimConfig | None = None) -> None:
        config = config or SimConfig()
        if config.gui and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            # PyBullet would end the whole process without a message.
            raise ValueError("gui needs a display, and DISPLAY is not set; run with gui false")
        with without_chatter():
            self.client = BulletClient(pybullet.GUI if config.gui else pybullet.DIRECT)
        if not self.client.isConnected():
            raise RuntimeError("PyBullet could not open its window; run with gui set to false")
        # Cached for every step: the attribute lookup takes as long as a call.
        self._set_motors = self.client.setJointMotorControlArray
        self._get_states = self.client.getJointStates
        self.step = self.client.stepSimulation
        self._offset_m, self._ball_radius_m = config.ball_offset_m, config.ball_radius_m
        self._on_arm = config.camera_mount == ON_ARM
        near_m = D435.near_m if self._on_arm else _NEAR_M
        self._names = [name or config.camera for name in config.kind.cameras]
        self._lens = config.lens
        self.renderers = [
            Renderer(self.client, config.lens(name), near_m) for name in config.kind.cameras
        ]
        try:
            self.client.setTimeStep(1.0 / config.physics_rate_hz)
            self.client.setGravity(0.0, 0.0, 0.0)
            self._known = robot_of(config.robot, config.urdf_path, config.ball_link)
            self._cameras = dict(self._known.cameras)
            link, joints = moving_joints(self._known)
            self._robot = self._load_robot()
            root_link = self.client.getBodyInfo(self._robot)[0].decode()
            self.camera_link = link if self._on_arm else root_link
            self._find_joints(joints, link)
            self._prepare_links()
            if not config.carries:
                raise ValueError("point_count: the arm carries a ball, of 1, or tags, of 4 each")
            self.body = CARRIED[config.carries](config)
            self._offset_m += self.body.depth_m
            self.object: Carried | None = self.body if self._on_arm else None
            if config.object_tag is not None:
                self.object = CarriedTag(replace(config, tag=config.object_tag))
            self.reset(np.zeros(len(self._joints)))
            self._zero_position_m, self.zero_link = self.carried_position(), self.link()
            self._mount = np.eye(3)
            if not self._on_arm:
                self._carried_body = self._body(self.body.shape(self.client))
                self._rod = self._add_rod()
                if self.body.tilt_rad is not None:
                    self._mount = self._facing(config) @ cv2.Rodrigues(self.body.tilt_rad)[0]
            if self.object is not None:
                self._object_body = self._body(self.object.shape(self.client))
            # Last: the renderer shades what is hidden as well, if it comes first.
            for item in config.objects:
                self._body(
                    sphere(self.client, item.size_m[0], item.rgba)
                    if len(item.size_m) == 1
                    else box(self.client, 0.5 * np.array(item.size_m), item.rgba),
                    item.position_m,
                )
            self.object_pose = self.placed_object(config)
            self.place_bodies()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Free the physics client; a second call does nothing."""
        if self.client.isConnected():
            self.client.disconnect()

    # ---------------------------------------------------------------- building
    def _load_robot(self) -> int:
        text = robot_description(self._known).replace('"file://', '"')
        with NamedTemporaryFile("w", suffix=".urdf", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            try:
                with without_chatter():  # of links without inertia, which move all the same
                    return self.client.loadURDF(
                        file.name, useFixedBase=True, flags=pybullet.URDF_USE_INERTIA_FROM_FILE
                    )
            except pybullet.error as error:
                raise ValueError(
                    f"urdf_path: PyBullet cannot load {self._known.file()} ({error})"
                ) from None

    def _find_joints(self, joints: list[UrdfJoint], link: str) -> None:
        """Find the joints from the root to the ball's link among PyBullet's."""
        count = self.client.getNumJoints(self._robot)
        infos = [self.client.getJointInfo(self._robot, index) for index in range(count)]
        indices = {info[1].decode(): info[0] for info in infos}
        moving = [info[0] for info in infos if info[3] >= 0]
        self._link = next(info[0] for info in infos if info[12].decode() == link)
        self.joints, self.joint_names = tuple(joints), tuple(joint.name for joint in joints)
        self._joints = [indices[name] for name in self.joint_names]
        #: Their places among all joints that move.
        self._columns = [moving.index(joint) for joint in self._joints]
        self._moving = len(moving)
        # A UR turns no joint further, and neither do others in here.
        self.lower_rad = np.maximum([joint.lower for joint in joints], -2.0 * np.pi)
        self.upper_rad = np.minimum([joint.upper for joint in joints], 2.0 * np.pi)
        self.max_speed_rad_s = np.array([joint.velocity for joint in joints])
        self._prismatic = np.array([joint.kind == "prismatic" for joint in joints], dtype=float)
        self._efforts_nm = [infos[joint][10] or 100.0 for joint in self._joints]

    def _prepare_links(self) -> None:
        for link in range(-1, self.client.getNumJoints(self._robot)):
            self.client.changeDynamics(
                self._robot, link, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0
            )
            mass, _, inertia, *_ = self.client.getDynamicsInfo(self._robot, link)
            if min(inertia) <= 0.0:  # many URDFs state none, and then some joints cannot be moved
                inertia = [max(mass, 0.1) * 0.05**2] * 3  # mass times squared radius of gyration
                self.client.changeDynamics(self._robot, link, localInertiaDiagonal=inertia)

        self._collide(False)

    def _collide(self, collides: bool) -> None:
        """Without collisions neither self-contact nor the table pushes the arm."""
        for link in range(-1, self.client.getNumJoints(self._robot)):
            self.client.setCollisionFilterGroupMask(
                self._robot, link, int(collides), -int(collides)
            )

    def _facing(self, config: SimConfig) -> np.ndarray:
        """The rotation in its link of a body whose z axis points to the camera at home."""
        camera = self.camera_home(config)
        self.reset(self.start_rad(config))
        out = camera.position_m - self.carried_position()
        out /= np.linalg.norm(out)
        right = np.cross((0.0, 0.0, 1.0) if abs(out[2]) < 0.99 else (1.0, 0.0, 0.0), out)
        right /= np.linalg.norm(right)
        facing = np.stack([right, np.cross(out, right), out], axis=1)
        return self.link().rotation.T @ facing

    def _add_rod(self) -> int:
        shape = self.client.createVisualShape(
            pybullet.GEOM_CYLINDER,
            radius=0.007,
            length=self._offset_m,
            rgbaColor=(0.27, 0.30, 0.34, 1.0),
            visualFramePosition=(0.0, 0.0, 0.5 * self._offset_m),
        )
        return self._body(shape)

    def _body(self, shape: int, position_m: tuple[float, ...] = (0.0, 0.0, 0.0)) -> int:
        return self.client.createMultiBody(
            baseMass=0.0, baseVisualShapeIndex=shape, basePosition=position_m
        )

    # ----------------------------------------------------------------- running
    def reset(self, joints_rad: np.ndarray) -> None:
        """Put the arm at rest at joint angles, rad, shape (n,)."""
        for joint, angle in zip(self._joints, np.asarray(joints_rad, dtype=float), strict=True):
            self.client.resetJointState(self._robot, joint, float(angle), 0.0)
        self.drive(np.zeros(len(self._joints)))

    def drive(self, velocities_rad_s: np.ndarray) -> None:
        """Set the joints' speeds, rad/s, shape (n,)."""
        self._set_motors(
            self._robot,
            self._joints,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=velocities_rad_s,
            forces=self._efforts_nm,
        )

    def joint_states(self) -> tuple[np.ndarray, np.ndarray]:
        """Joint angles, rad, and velocities, rad/s, each of shape (n,)."""
        states = self._get_states(self._robot, self._joints)
        return np.array([s[0] for s in states]), np.array([s[1] for s in states])

    # ------------------------------------------------------------- ball or tag
    def _link_state(self) -> tuple:
        return self.client.getLinkState(self._robot, self._link, computeForwardKinematics=True)

    def link(self) -> RigidPose:
        """The last link's pose, world frame."""
        state = self._link_state()
        return RigidPose(np.array(state[4]), _matrix(state[5]))

    def carried_position(self) -> np.ndarray:
        """Centre of the ball or tag on the arm, world frame, m, shape (3,)."""
        link = self.link()
        return link.position_m + self._offset_m * link.rotation[:, 2]

    def feature_pose(self) -> RigidPose:
        """What is servoed, world frame; a tag's x to the right of the print, z out of it."""
        if self._on_arm:
            return self.object_pose
        return RigidPose(self.carried_position(), self.link().rotation @ self._mount)

    def photograph(
        self,
        config: SimConfig,
        camera: RigidPose,
        velocities_rad_s: np.ndarray,
        rng: np.random.Generator,
        region: Region | None = None,
        number: int = 0,
    ) -> tuple[np.ndarray, np.ndarray]:
        """What a camera with these errors sends of its image, or of a part of it.

        As :meth:`Renderer.render`; ``velocities_rad_s`` of the joints blur a tag, (n,).
        """
        renderer = self.renderers[number]
        intrinsics, part = renderer.intrinsics, region or Region.whole(renderer.lens)
        if config.covers(config.kind.cameras[number]):
            shape = part.height, part.width
            return np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.float32)
        step = ceil(max(part.width, part.height) / self.body.drawn_px) if region else 1
        if renderer.undistorted:
            u, v = (each[part.part] for each in renderer.undistorted)
            ends_px = np.array([[u.min(), v.min()], [u.max(), v.max()]])
            region = Region.around(ends_px).grown(2, intrinsics)
            u, v = u - region.u0, v - region.v0
        view = region.view(intrinsics) if region else intrinsics
        rgb, depth_m = renderer.render(camera, region, step)
        if not config.use_depth:  # a camera's edge pixels are means, and tell the ball's size
            ball = self.body.part(camera.pose_to_own(self.feature_pose()), intrinsics)
            if fine := region or (ball and ball.grown(8, intrinsics)):
                rgb[... if region else fine.part] = renderer.render(camera, fine, 1.0 / 3.0)[0]
        joints = self.joint_states()[0]
        arm_m_s = self.chain.jacobian(joints) @ velocities_rad_s
        arm_rad_s = velocities_rad_s @ self.chain.motion(joints)[1]
        bodies = []
        if not self._on_arm:
            bodies.append((self.body, self.feature_pose(), arm_m_s, arm_rad_s))
        if self.object is not None:
            linear = np.array(config.object_velocity_m_s)
            angular = np.array([0.0, 0.0, np.radians(config.object_turn_rate_deg_s)])
            if self._on_arm:
                beside_m = self.object_pose.position_m - self.carried_position()
                linear -= arm_m_s + np.cross(arm_rad_s, beside_m)
                angular -= arm_rad_s
            bodies.append((self.object, self.object_pose, linear, angular))
        for body, pose, linear, angular in bodies:
            speeds = linear @ camera.rotation, angular @ camera.rotation
            poses = exposed(camera.pose_to_own(pose), *speeds, config.exposure_s)
            body.paint((rgb, depth_m, view), poses, rng)
        if renderer.undistorted:
            return cv2.remap(rgb, u, v, cv2.INTER_LINEAR), np.zeros(u.shape, np.float32)
        if step > 1:  # for a detector that takes no depths
            return rgb, depth_m
        depth_m = add_depth_noise(depth_m, intrinsics.fx, rng, config.depth_noise)
        return rgb, depth_m * np.float32(1.0 + config.depth_error)

    @cached_property
    def chain(self) -> SerialChain:
        """The arm's axes and its ball, world frame: the truth, for many joint angles at once."""
        return self.chain_with(Ball())

    def chain_with(self, kind: Kind) -> SerialChain:
        """The same with what is measured of ball or tag, or, for image points, their points."""
        mount = self.zero_link.rotation @ self._mount
        carried = kind.of_body(self._zero_position_m, mount)
        if not kind.rigid:
            ways_m = self.body.points_m @ mount.T
            ways_m[1:] -= ways_m[0]
            carried = np.append(carried + ways_m[0], ways_m[1:])
        # PyBullet takes the point along the link's inertial axes.
        point = _matrix(self._link_state()[3]).T @ [0.0, 0.0, self._offset_m]
        zeros = [0.0] * self._moving
        jacobians = self.client.calculateJacobian(
            self._robot, self._link, point.tolist(), zeros, zeros, zeros
        )
        linear, axes = (np.array(jacobian)[:, self._columns].T for jacobian in jacobians)
        points_m = self._zero_position_m + np.cross(axes, linear)
        axes = np.where(self._prismatic[:, None], linear, axes)
        reference = np.zeros(len(self._joints))
        return SerialChain(axes, points_m, carried, reference, self._prismatic)

    # --------------------------------------------------- where to begin, and from where to watch
    @cached_property
    def _placement(self) -> Placement:
        return Placement(self.chain, self.lower_rad, self.upper_rad)

    @cached_property
    def home_rad(self) -> np.ndarray:
        """The joints to begin with, rad, shape (n,)."""
        known = self._known.home_rad
        return np.array(known) if known else self._placement.home()

    def start_rad(
        self, config: SimConfig, joints_rad: Sequence[float] | np.ndarray | None = None
    ) -> np.ndarray:
        """The joints to begin with, rad, (n,): those that are given, or the configuration's."""
        if joints_rad is None:
            joints_rad = config.initial_joints_rad or self.home_rad
        joints = np.array(joints_rad, dtype=float)
        if joints.shape != self.lower_rad.shape or not np.isfinite(joints).all():
            count = len(self.lower_rad)
            raise ValueError(f"the arm needs {count} finite joint angles, got {joints.tolist()}")
        return joints

    def camera_home(self, config: SimConfig, number: int = 0) -> RigidPose:
        """The pose in ``camera_link`` of a camera that nobody has bumped."""
        if config.camera_pose is not None and not number:
            return config.camera_pose
        return BRACKET if self._on_arm else self.camera(self._names[number])

    def placed_object(self, config: SimConfig) -> RigidPose:
        """Where the parameters put the object, world frame."""
        position_m = np.array(config.object_position_m)
        rotation = rotation_from_vector(np.radians(config.object_rotation_deg))
        if self._on_arm:  # by default in front of the camera at home
            motion = self.chain.transform(self.start_rad(config)).T
            link = RigidPose(motion[:3, 3], motion[:3, :3]).pose_from_own(self.zero_link)
            camera = link.pose_from_own(self.camera_home(config))
            if config.object_position_m == SimConfig.object_position_m:
                position_m = camera.position_m + config.ahead_m * camera.rotation[:, 2]
            if config.object_rotation_deg == SimConfig.object_rotation_deg:
                aslant = rotation_from_vector(np.array(config.aslant_rad))
                rotation = camera.rotation @ _OPTICAL_TO_GL @ aslant
        return RigidPose(position_m, rotation)

    def camera(self, name: str) -> RigidPose:
        """A named camera's pose."""
        if name not in self._cameras:
            joints_rad, _ = self.joint_states()
            self._collide(True)
            front = self.camera("front").position_m if name == "side" else None
            self._cameras[name] = self._placement.camera(
                name, self.home_rad, self._lens(name), self._hidden, front
            )
            self._collide(False)
            self.reset(joints_rad)
        return self._cameras[name]

    def _hidden(self, joints_rad: np.ndarray, poses: list[RigidPose]) -> np.ndarray:
        """Shares of the ball that the arm hides from poses at some joints, by five rays each."""
        self.reset(joints_rad)
        self.client.performCollisionDetection()
        ball_m, shares = self.carried_position(), np.empty(len(poses))
        for index, pose in enumerate(poses):
            across = 0.8 * self._ball_radius_m * pose.rotation[:, :2].T
            ends = ball_m + np.vstack([np.zeros(3), across, -across])
            starts = np.tile(pose.position_m, (len(ends), 1))
            hits = self.client.rayTestBatch(starts.tolist(), ends.tolist())
            shares[index] = np.mean([hit[0] >= 0 for hit in hits])
        return shares

    def move_object(self, config: SimConfig, dt_s: float) -> None:
        """Let belt and turntable carry the object on."""
        angle_rad = np.radians(config.object_turn_rate_deg_s * dt_s)
        way_m = dt_s * np.array(config.object_velocity_m_s)
        if self.object is not None and (angle_rad or way_m.any()):
            rotation = rotation_from_vector(np.array([0.0, 0.0, angle_rad]))
            position_m = self.object_pose.position_m + way_m
            self.object_pose = RigidPose(position_m, rotation @ self.object_pose.rotation)

    def place_bodies(self) -> None:
        """Move ball or tag, its rod, and the object to their present poses; before rendering."""
        if not self._on_arm:
            state, pose = self._link_state(), self.feature_pose()
            foot = np.array(state[4]) - self.body.rod_gap_m * pose.rotation[:, 2]
            self.client.resetBasePositionAndOrientation(self._rod, foot, state[5])
            self._put(self._carried_body, pose)
        if self.object is not None:
            self._put(self._object_body, self.object_pose)

    def _put(self, body: int, pose: RigidPose) -> None:
        quaternion_xyzw = quaternion_from_rotation(pose.rotation)
        self.client.resetBasePositionAndOrientation(body, pose.position_m, quaternion_xyzw)


class Renderer:
    """Draws one world as one camera sees it, by PyBullet's software renderer.

    It draws for a pinhole camera, ``intrinsics``: the ``lens`` itself, or, where that distorts, one
    that sees as much; ``undistorted`` is then where its pixels are there. A part of the image is
    drawn with an off-axis frustum and equals the crop of the full image, so that a small window
    around the ball costs a small part of a full image.
    """

    def __init__(self, client: BulletClient, lens: Intrinsics, near_m: float = _NEAR_M) -> None:
        self._client = client
        self.lens = intrinsics = lens
        self.undistorted: list[np.ndarray] = []
        if isinstance(lens, Lens):
            intrinsics, *self.undistorted = lens.pinhole()
        self.intrinsics = intrinsics
        self._near_m = near_m  # what is nearer is not drawn
        rows = np.linspace(0.0, 1.0, intrinsics.height)[:, None]
        top_rgb, bottom_rgb = np.array([214, 224, 234]), np.array([244, 246, 247])
        colours = (1.0 - rows) * top_rgb + rows * bottom_rgb
        opaque = np.insert(np.round(colours).astype(np.uint8), 3, 255, axis=1)
        self._wall = opaque.view(np.uint32)

    def render(
        self, pose: RigidPose, region: Region | None = None, step: float = 1.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Draw the image, or a part of it, in squares of ``step`` pixels, or of a part of a pixel.

        Colours, uint8, (H, W, 3), and depth along the optical axis, float32, (H, W), m; 0 where
        there is none.
        """
        part = region or Region.whole(self.intrinsics)
        view = part.view(self.intrinsics)
        colours, raw = self._draw(pose, view.coarser(step))
        nothing = raw >= 0.999999
        scale = np.float32(1.0 / self._near_m - 1.0 / _FAR_M)
        depth = np.float32(1.0) / (np.float32(1.0 / self._near_m) - scale * raw)
        depth[nothing] = 0.0
        # Filling four bytes at once takes a tenth of the time of filling colour by colour.
        wall = self._wall[part.part[0]][(step * np.arange(len(raw))).astype(int)]
        np.copyto(colours.view(np.uint32)[..., 0], wall, where=nothing)
        rgb = cv2.cvtColor(colours, cv2.COLOR_RGBA2RGB)
        rgb = cv2.resize(rgb, None, None, step, step, cv2.INTER_AREA)
        depth = cv2.resize(depth, None, None, step, step, cv2.INTER_NEAREST)
        return rgb[: view.height, : view.width], depth[: view.height, : view.width]

    def _draw(self, pose: RigidPose, camera: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
        """Colours (H, W, 4) and the depth buffer (H, W), 1 for the background."""
        _, _, rgba, buffer, _ = self._client.getCameraImage(
            camera.width,
            camera.height,
            viewMatrix=_view_matrix(pose),
            projectionMatrix=_projection_matrix(camera, self._near_m),
            lightDirection=(0.6, 0.5, 1.0),
            lightColor=(1.0, 1.0, 1.0),
            lightDistance=3.0,
            shadow=0,
            lightAmbientCoeff=0.62,
            lightDiffuseCoeff=0.42,
            lightSpecularCoeff=0.08,
            renderer=pybullet.ER_TINY_RENDERER,
            flags=pybullet.ER_NO_SEGMENTATION_MASK,
        )
        shape = (camera.height, camera.width)
        # Without numpy PyBullet gives tuples; a bytearray takes an eighth of numpy's time on them.
        return (
            np.frombuffer(bytearray(rgba), np.uint8).reshape(*shape, 4),
            np.asarray(buffer, dtype=np.float32).reshape(shape),
        )


def _matrix(quaternion_xyzw: Any) -> np.ndarray:
    return np.reshape(pybullet.getMatrixFromQuaternion(quaternion_xyzw), (3, 3))


def _view_matrix(pose: RigidPose) -> list[float]:
    rotation = _OPTICAL_TO_GL @ pose.rotation.T
    view = np.eye(4)
    view[:3, :3] = rotation
    view[:3, 3] = -rotation @ pose.position_m
    return view.T.ravel().tolist()


def _projection_matrix(camera: Intrinsics, near_m: float) -> list[float]:
    # Corrects the renderer's offset of half a pixel right and up from the pinhole model.
    projection = np.zeros((4, 4))
    projection[0, 0] = 2.0 * camera.fx / camera.width
    projection[0, 2] = 1.0 - 2.0 * camera.cx / camera.width
    projection[1, 1] = 2.0 * camera.fy / camera.height
    projection[1, 2] = 2.0 * (camera.cy + 1.0) / camera.height - 1.0
    projection[2, 2] = -(_FAR_M + near_m) / (_FAR_M - near_m)
    projection[2, 3] = -2.0 * _FAR_M * near_m / (_FAR_M - near_m)
    projection[3, 2] = -1.0
    return projection.T.ravel().tolist()
