"""The PyBullet world: the arm, its ball, a table, and any other objects.

Only this module and :mod:`fvs_sim_node.rendering` call the physics engine. Every world is its
own client, so that many of them live side by side in one process.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np
import pybullet
from pybullet_utils.bullet_client import BulletClient

from fvs_ros.joints import UR_JOINT_NAMES
from fvs_sim_node.config import SimConfig
from fvs_sim_node.icosphere import icosphere
from fvs_sim_node.objects import BALL_RGBA, SceneObject
from fvs_sim_node.ur5_urdf import urdf_text

_HALF_TURN = (0.0, 0.0, 1.0, 0.0)
_ROD_RGBA = (0.27, 0.30, 0.34, 1.0)
_ROD_RADIUS_M = 0.007
_NOWHERE = (0.0, 0.0, 0.0)


class World:
    """An arm with driven joints and a ball on its end.

    The world frame is the robot's Denavit-Hartenberg ``base`` frame, for which the root of the
    URDF (ROS's ``base_link``) is turned by half a turn about z. Gravity is off, since a UR's
    controller compensates it.

    Parameters
    ----------
    config : SimConfig, optional
        Robot, ball, objects and step.

    Attributes
    ----------
    client : BulletClient
        PyBullet's functions for this world.
    lower_rad, upper_rad, max_speed_rad_s : ndarray, shape (n,)
        Limits of the joints.

    Raises
    ------
    ValueError
        If the URDF cannot be loaded or lacks a joint or the link; the text says which.
    """

    def __init__(self, config: SimConfig | None = None) -> None:
        config = config or SimConfig()
        if config.gui and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            # PyBullet would end the whole process, without a word of its own.
            raise ValueError("gui needs a display, and DISPLAY is not set; run with gui false")
        self.client = BulletClient(pybullet.GUI if config.gui else pybullet.DIRECT)
        if not self.client.isConnected():
            raise RuntimeError("PyBullet could not open its window; run with gui set to false")
        # For every step: looking them up takes as long as one of them.
        self._set_motors = self.client.setJointMotorControlArray
        self._get_states = self.client.getJointStates
        self._step = self.client.stepSimulation
        self._ball_offset_m = config.ball_offset_m
        try:
            self.client.setTimeStep(1.0 / config.physics_rate_hz)
            self.client.setGravity(0.0, 0.0, 0.0)
            self._robot = self._load_robot(config.urdf_path)
            self._find_joints_and_link(config.urdf_path, config.ball_link)
            self._prepare_joints()
            for thing in config.objects:
                self.add_object(thing)
            self._ball = self._body(self._sphere(config.ball_radius_m, BALL_RGBA))
            self._rod = self._add_rod()
            self.place_ball()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Free the physics client; a second call does nothing."""
        if self.client.isConnected():
            self.client.disconnect()

    # ---------------------------------------------------------------- building
    def _load_robot(self, urdf_path: str) -> int:
        if urdf_path and not Path(urdf_path).is_file():
            raise ValueError(f"urdf_path: there is no file {urdf_path}")
        with tempfile.TemporaryDirectory(prefix="fvs_ur5_") as folder:
            path = Path(urdf_path) if urdf_path else Path(folder) / "ur5.urdf"
            if not urdf_path:
                path.write_text(urdf_text(), encoding="utf-8")
            try:
                return self.client.loadURDF(
                    str(path),
                    baseOrientation=_HALF_TURN,
                    useFixedBase=True,
                    flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
                )
            except pybullet.error as error:
                raise ValueError(
                    f"urdf_path: PyBullet cannot load {path} ({error}); it needs a plain URDF "
                    "whose mesh files are found relative to it"
                ) from None

    def _find_joints_and_link(self, urdf_path: str, ball_link: str) -> None:
        count = self.client.getNumJoints(self._robot)
        infos = [self.client.getJointInfo(self._robot, index) for index in range(count)]
        joints = {info[1].decode(): info for info in infos}
        links = {info[12].decode(): info[0] for info in infos}
        what = urdf_path or "the built-in UR5"
        missing = [name for name in UR_JOINT_NAMES if name not in joints]
        if missing:
            raise ValueError(
                f"urdf_path: {what} lacks the joints {missing}; it has {sorted(joints)}. A UR5 "
                "model with the joint names of ur_description is needed"
            )
        fixed = [name for name in UR_JOINT_NAMES if joints[name][3] < 0]
        if fixed:
            raise ValueError(f"urdf_path: {what} has fixed joints {fixed}; they must move")
        if ball_link and ball_link not in links:
            raise ValueError(f"ball_link: {what} has no link {ball_link!r}; it has {list(links)}")
        self._link = links[ball_link or ("tool0" if "tool0" in links else list(links)[-1])]
        used = [joints[name] for name in UR_JOINT_NAMES]
        self._joints = [info[0] for info in used]
        moving = [info[0] for info in infos if info[3] >= 0]
        #: Their places among all joints that move.
        self._columns = [moving.index(joint) for joint in self._joints]
        self._moving = len(moving)
        limited = np.array([info[8] < info[9] for info in used])
        self.lower_rad = np.where(limited, [info[8] for info in used], -2 * np.pi)
        self.upper_rad = np.where(limited, [info[9] for info in used], 2 * np.pi)
        self._efforts_nm = [info[10] for info in used]
        self.max_speed_rad_s = np.array([info[11] for info in used])

    def _prepare_joints(self) -> None:
        for joint in range(-1, self.client.getNumJoints(self._robot)):
            self.client.changeDynamics(
                self._robot, joint, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0
            )
            # A UR may touch itself in a pose that is of no use here, but must not push the table.
            self.client.setCollisionFilterGroupMask(self._robot, joint, 0, 0)
        self.reset(np.zeros(len(self._joints)))

    def add_object(self, thing: SceneObject) -> int:
        """Put a thing into view; returns its body number."""
        if thing.kind == "sphere":
            shape = self._sphere(thing.size_m[0], thing.rgba)
        elif thing.kind == "box":
            shape = self.client.createVisualShape(
                pybullet.GEOM_BOX,
                halfExtents=[0.5 * edge for edge in thing.size_m],
                rgbaColor=thing.rgba,
            )
        else:
            raise ValueError(f"unknown kind of object {thing.kind!r}; known are box, sphere")
        return self._body(shape, thing.position_m)

    def _sphere(self, radius_m: float, rgba: tuple[float, ...]) -> int:
        # A <sphere> is drawn 5 % too small. The mesh's flat faces lie 0.27 % inside its corners.
        vertices, triangles = icosphere(3)
        radius_m *= 1.0027
        return self.client.createVisualShape(
            pybullet.GEOM_MESH,
            vertices=(vertices * radius_m).tolist(),
            indices=triangles.ravel().tolist(),
            normals=vertices.tolist(),
            rgbaColor=rgba,
        )

    def _add_rod(self) -> int:
        shape = self.client.createVisualShape(
            pybullet.GEOM_CYLINDER,
            radius=_ROD_RADIUS_M,
            length=self._ball_offset_m,
            rgbaColor=_ROD_RGBA,
            visualFramePosition=(0.0, 0.0, 0.5 * self._ball_offset_m),
        )
        return self._body(shape)

    def _body(self, shape: int, position_m: tuple[float, float, float] = _NOWHERE) -> int:
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

    def step(self) -> None:
        """One step of the physics."""
        self._step()

    def joint_states(self) -> tuple[np.ndarray, np.ndarray]:
        """Joint angles, rad, and velocities, rad/s, each of shape (n,)."""
        states = self._get_states(self._robot, self._joints)
        return np.array([s[0] for s in states]), np.array([s[1] for s in states])

    # -------------------------------------------------------------------- ball
    def _link_state(self) -> tuple:
        return self.client.getLinkState(self._robot, self._link, computeForwardKinematics=True)

    def ball_position(self) -> np.ndarray:
        """Centre of the ball, world frame, m, shape (3,)."""
        state = self._link_state()
        return np.array(state[4]) + self._ball_offset_m * _matrix(state[5])[:, 2]

    def ball_jacobian(self, joints_rad: np.ndarray) -> np.ndarray:
        """Jacobian of the ball's position at any joint angles, from the loaded model.

        Parameters
        ----------
        joints_rad : array_like, shape (n,)
            Joint angles, rad.

        Returns
        -------
        ndarray, shape (3, n)
            m/rad, world frame.
        """
        # PyBullet wants the point along the axes of the link's inertia, and answers in the base's.
        ball_m = np.array([0.0, 0.0, self._ball_offset_m])
        point = _matrix(self._link_state()[3]).T @ ball_m
        zeros = [0.0] * self._moving
        angles = np.zeros(self._moving)
        angles[self._columns] = joints_rad
        linear, _ = self.client.calculateJacobian(
            self._robot, self._link, point.tolist(), angles.tolist(), zeros, zeros
        )
        return _matrix(_HALF_TURN) @ np.array(linear)[:, self._columns]

    def place_ball(self) -> None:
        """Move the visible ball and its rod to where the link is now; call before rendering."""
        state = self._link_state()
        self.client.resetBasePositionAndOrientation(self._rod, state[4], state[5])
        self.client.resetBasePositionAndOrientation(self._ball, self.ball_position(), state[5])


def _matrix(quaternion_xyzw: tuple[float, ...]) -> np.ndarray:
    return np.reshape(pybullet.getMatrixFromQuaternion(quaternion_xyzw), (3, 3))
