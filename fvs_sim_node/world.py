"""The PyBullet world: the arm, its ball, a table, and any other objects.

Only this module and :mod:`fvs_sim_node.rendering` call the physics engine. Every world is its
own client, so that many of them live side by side in one process.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
import pybullet

from fvs_ros.joints import N_JOINTS, UR_JOINT_NAMES
from fvs_sim_node.icosphere import icosphere
from fvs_sim_node.objects import BALL_RGBA, TABLE, SceneObject
from fvs_sim_node.ur5_urdf import EFFORT_LIMITS_NM, urdf_text

_HALF_TURN = (0.0, 0.0, 1.0, 0.0)
_ROD_RGBA = (0.27, 0.30, 0.34, 1.0)
_ROD_RADIUS_M = 0.007


class World:
    """An arm with six driven joints and a ball on its end.

    The world frame is the robot's Denavit-Hartenberg ``base`` frame, for which the root of the
    URDF (ROS's ``base_link``) is turned by half a turn about z. Gravity is off, since a UR's
    controller compensates it.

    Parameters
    ----------
    urdf_path : str
        Any UR5 model with the joint names of ``ur_description``; empty for the built-in one.
    ball_link : str
        Link that carries the ball, on its z axis; empty for ``tool0``, or the last link if there
        is none.
    ball_radius_m, ball_offset_m : float
        Radius, and distance of the centre from the link's origin, m.
    physics_rate_hz : float
        Steps per second.
    gui : bool
        Whether to open PyBullet's window (one per process).
    objects : iterable of SceneObject
        What else is in view.

    Raises
    ------
    ValueError
        If the URDF cannot be loaded or lacks a joint or the link; the text says which.
    """

    def __init__(
        self,
        *,
        urdf_path: str = "",
        ball_link: str = "",
        ball_radius_m: float = 0.04,
        ball_offset_m: float = 0.09,
        physics_rate_hz: float = 500.0,
        gui: bool = False,
        objects: Iterable[SceneObject] = TABLE,
    ) -> None:
        if gui and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            # PyBullet would end the whole process, without a word of its own.
            raise ValueError("gui needs a display, and DISPLAY is not set; run with gui false")
        self.client = pybullet.connect(pybullet.GUI if gui else pybullet.DIRECT)
        if self.client < 0:
            raise RuntimeError("PyBullet could not open its window; run with gui set to false")
        self._ball_offset_m = ball_offset_m
        try:
            pybullet.setTimeStep(1.0 / physics_rate_hz, physicsClientId=self.client)
            pybullet.setGravity(0.0, 0.0, 0.0, physicsClientId=self.client)
            self._robot = self._load_robot(urdf_path)
            self._find_joints_and_link(urdf_path, ball_link)
            self._prepare_joints()
            for thing in objects:
                self.add_object(thing)
            self._ball = self._add_ball(ball_radius_m)
            self._rod = self._add_rod(ball_offset_m)
            self.place_ball()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Free the physics client; a second call does nothing."""
        if self.client >= 0 and pybullet.isConnected(physicsClientId=self.client):
            pybullet.disconnect(physicsClientId=self.client)
        self.client = -1

    # ---------------------------------------------------------------- building
    def _load_robot(self, urdf_path: str) -> int:
        if not urdf_path:
            with tempfile.TemporaryDirectory(prefix="fvs_ur5_") as folder:
                path = Path(folder) / "ur5.urdf"
                path.write_text(urdf_text(), encoding="utf-8")
                return self._load_urdf(path)
        if not Path(urdf_path).is_file():
            raise ValueError(f"urdf_path: there is no file {urdf_path}")
        return self._load_urdf(Path(urdf_path))

    def _load_urdf(self, path: Path) -> int:
        try:
            return pybullet.loadURDF(
                str(path),
                baseOrientation=_HALF_TURN,
                useFixedBase=True,
                flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
                physicsClientId=self.client,
            )
        except pybullet.error as error:
            raise ValueError(
                f"urdf_path: PyBullet cannot load {path} ({error}); it needs a plain URDF whose "
                "mesh files are found relative to it"
            ) from None

    def _find_joints_and_link(self, urdf_path: str, ball_link: str) -> None:
        joints: dict[str, int] = {}
        links: dict[str, int] = {}
        moving: list[int] = []
        for index in range(pybullet.getNumJoints(self._robot, physicsClientId=self.client)):
            info = pybullet.getJointInfo(self._robot, index, physicsClientId=self.client)
            joints[info[1].decode()] = index
            links[info[12].decode()] = index
            if info[3] >= 0:
                moving.append(index)
        what = urdf_path or "the built-in UR5"
        missing = [name for name in UR_JOINT_NAMES if name not in joints]
        if missing:
            raise ValueError(
                f"urdf_path: {what} lacks the joints {missing}; it has {sorted(joints)}. A UR5 "
                "model with the joint names of ur_description is needed"
            )
        fixed = [name for name in UR_JOINT_NAMES if joints[name] not in moving]
        if fixed:
            raise ValueError(f"urdf_path: {what} has fixed joints {fixed}; they must move")
        if ball_link and ball_link not in links:
            raise ValueError(f"ball_link: {what} has no link {ball_link!r}; it has {list(links)}")
        self._joints = [joints[name] for name in UR_JOINT_NAMES]
        self.ball_link = ball_link or ("tool0" if "tool0" in links else list(links)[-1])
        self._link = links[self.ball_link]

    def _prepare_joints(self) -> None:
        lower, upper = np.full(N_JOINTS, -2 * np.pi), np.full(N_JOINTS, 2 * np.pi)
        for i, joint in enumerate(self._joints):
            info = pybullet.getJointInfo(self._robot, joint, physicsClientId=self.client)
            if info[8] < info[9]:
                lower[i], upper[i] = info[8], info[9]
        self.lower_rad, self.upper_rad = lower, upper
        for joint in range(-1, pybullet.getNumJoints(self._robot, physicsClientId=self.client)):
            pybullet.changeDynamics(
                self._robot,
                joint,
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
                physicsClientId=self.client,
            )
            # A UR may touch itself in a pose that is of no use here, but must not push the table.
            pybullet.setCollisionFilterGroupMask(
                self._robot, joint, 0, 0, physicsClientId=self.client
            )
        self.reset(np.zeros(N_JOINTS))
        self._measure_axes()

    def add_object(self, thing: SceneObject) -> int:
        """Put a thing into view; returns its body number."""
        if thing.kind == "sphere":
            shape = self._sphere(thing.size_m[0], thing.rgba)
        elif thing.kind == "box":
            shape = pybullet.createVisualShape(
                pybullet.GEOM_BOX,
                halfExtents=[0.5 * edge for edge in thing.size_m],
                rgbaColor=thing.rgba,
                physicsClientId=self.client,
            )
        else:
            raise ValueError(f"unknown kind of object {thing.kind!r}; known are box, sphere")
        return self._body(shape, thing.position_m)

    def _sphere(self, radius_m: float, rgba: tuple[float, ...]) -> int:
        # A <sphere> is drawn 5 % too small. The mesh's flat faces lie 0.27 % inside its corners.
        vertices, triangles = icosphere(3)
        radius_m *= 1.0027
        return pybullet.createVisualShape(
            pybullet.GEOM_MESH,
            vertices=(vertices * radius_m).tolist(),
            indices=triangles.ravel().tolist(),
            normals=vertices.tolist(),
            rgbaColor=rgba,
            physicsClientId=self.client,
        )

    def _body(self, shape: int, position_m: tuple[float, float, float]) -> int:
        return pybullet.createMultiBody(
            baseMass=0.0,
            baseVisualShapeIndex=shape,
            basePosition=position_m,
            physicsClientId=self.client,
        )

    def _add_ball(self, radius_m: float) -> int:
        return self._body(self._sphere(radius_m, BALL_RGBA), (0.0, 0.0, 0.0))

    def _add_rod(self, length_m: float) -> int:
        shape = pybullet.createVisualShape(
            pybullet.GEOM_CYLINDER,
            radius=_ROD_RADIUS_M,
            length=length_m,
            rgbaColor=_ROD_RGBA,
            visualFramePosition=(0.0, 0.0, 0.5 * length_m),
            physicsClientId=self.client,
        )
        return self._body(shape, (0.0, 0.0, 0.0))

    # ----------------------------------------------------------------- running
    def reset(self, joints_rad: np.ndarray) -> None:
        """Put the arm at rest at joint angles, rad, shape (6,)."""
        for joint, angle in zip(self._joints, np.asarray(joints_rad, dtype=float), strict=True):
            pybullet.resetJointState(
                self._robot, joint, float(angle), 0.0, physicsClientId=self.client
            )
        self.drive(np.zeros(N_JOINTS))

    def drive(self, velocities_rad_s: np.ndarray) -> None:
        """Set the joints' speeds, rad/s, shape (6,)."""
        pybullet.setJointMotorControlArray(
            self._robot,
            self._joints,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=velocities_rad_s,
            forces=EFFORT_LIMITS_NM,
            physicsClientId=self.client,
        )

    def step(self) -> None:
        """One step of the physics."""
        pybullet.stepSimulation(physicsClientId=self.client)

    def joint_states(self) -> tuple[np.ndarray, np.ndarray]:
        """Joint angles, rad, and velocities, rad/s, each of shape (6,)."""
        states = pybullet.getJointStates(self._robot, self._joints, physicsClientId=self.client)
        return np.array([s[0] for s in states]), np.array([s[1] for s in states])

    # -------------------------------------------------------------------- ball
    def _frame(self, link: int) -> tuple[np.ndarray, np.ndarray]:
        """Origin, m, and rotation of a link's frame in the world."""
        state = pybullet.getLinkState(
            self._robot, link, computeForwardKinematics=True, physicsClientId=self.client
        )
        rotation = np.reshape(pybullet.getMatrixFromQuaternion(state[5]), (3, 3))
        return np.array(state[4]), rotation

    def ball_position(self) -> np.ndarray:
        """Centre of the ball, world frame, m, shape (3,)."""
        position, rotation = self._frame(self._link)
        return position + self._ball_offset_m * rotation[:, 2]

    def ball_jacobian(self, joints_rad: np.ndarray) -> np.ndarray:
        """Jacobian of the ball's position at any joint angles, from the loaded model.

        Parameters
        ----------
        joints_rad : array_like, shape (6,)
            Joint angles, rad.

        Returns
        -------
        ndarray, shape (3, 6)
            m/rad, world frame.
        """
        point = np.append(self._ball_at_zero_m, 1.0)
        motion = np.eye(4)
        axes, origins = [], []
        for angle, axis, origin in zip(
            np.asarray(joints_rad, dtype=float), self._axes, self._origins_m, strict=True
        ):
            axes.append(motion[:3, :3] @ axis)
            origins.append(motion[:3, :3] @ origin + motion[:3, 3])
            turn = np.eye(4)
            turn[:3, :3] = cv2.Rodrigues(angle * axis)[0]
            turn[:3, 3] = origin - turn[:3, :3] @ origin
            motion = motion @ turn
        ball = (motion @ point)[:3]
        return np.cross(axes, ball - np.array(origins)).T

    def _measure_axes(self) -> None:
        """Joint axes, a point on each, and the ball, all at zero angles."""
        axes, origins = [], []
        for joint in self._joints:
            info = pybullet.getJointInfo(self._robot, joint, physicsClientId=self.client)
            state = pybullet.getLinkState(
                self._robot, joint, computeForwardKinematics=True, physicsClientId=self.client
            )
            # PyBullet gives the axis in the frame of the link's inertia.
            inertial = np.reshape(pybullet.getMatrixFromQuaternion(state[1]), (3, 3))
            axes.append(inertial @ np.array(info[13]))
            origins.append(np.array(state[4]))
        self._axes, self._origins_m = axes, origins
        self._ball_at_zero_m = self.ball_position()

    def place_ball(self) -> None:
        """Move the visible ball and its rod to where the link is now; call before rendering."""
        state = pybullet.getLinkState(
            self._robot, self._link, computeForwardKinematics=True, physicsClientId=self.client
        )
        pybullet.resetBasePositionAndOrientation(
            self._rod, state[4], state[5], physicsClientId=self.client
        )
        pybullet.resetBasePositionAndOrientation(
            self._ball, self.ball_position(), state[5], physicsClientId=self.client
        )
