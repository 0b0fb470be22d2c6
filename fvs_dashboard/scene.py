"""The 3-D view: arm, camera, ball or tag, object, and target."""

from __future__ import annotations

import io
import logging
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from math import inf

import numpy as np
import viser
import yourdfpy
from viser.extras import ViserUrdf
from viser.transforms import SE3, SO3

from fvs_dashboard.board import OBJECT_POSITION, OBJECT_ROTATION, Action, Board
from fvs_dashboard.picture import TARGET_RGB
from fvs_ros import topics
from fvs_ros.kinds.kind import FIXED, ON_ARM, Kind
from fvs_ros.urdf import read_robot
from fvs_sim_node.robot import find_meshes

_MEASURED, _PREDICTED, _OBJECT = (213, 40, 30), (255, 214, 0), (204, 121, 167)
_MOVING = ("◉", _PREDICTED, "where it is now"), ("●", TARGET_RGB, "target: drag it")
#: What the colours mean in the view, by where the camera is.
LEGENDS = {
    FIXED: (("●", _MEASURED, "as measured"), *_MOVING, ("■", _OBJECT, "object")),
    ON_ARM: (("■", _OBJECT, "object, as measured"), *_MOVING),
}
#: Vertical angle of a RealSense's view, rad, and width over height.
_VIEW = 0.743, 4.0 / 3.0


class Scene:
    """The content of the 3-D view; the camera's measurements are shown in its frame.

    With the camera on the arm, the object's pose as a target is shown, and dragged, as the pose of
    the camera in the room from which the object is seen like that.

    ``on_drag`` gets an action while target or simulated object are dragged or rotated, and when let
    go.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        ball_radius_m: float,
        kind: Kind,
        on_drag: Callable[[Action], None],
    ) -> None:
        self._server, self._kind = server, kind
        self._turns = kind.size > 3  # what is servoed; a ball does not
        self._aims_camera = kind.on_arm and self._turns
        self._on_drag = on_drag
        self._held_s = {"target": -inf, "object": -inf}  # when a person last held it
        self._arm: Arm | None = None
        self._robot: ViserUrdf | None = None
        self._add_surroundings()
        scene = server.scene
        self._root = scene.add_frame("/robot", show_axes=False, visible=False)
        self._camera = scene.add_frame(
            "/camera", axes_length=0.08, axes_radius=0.003, origin_radius=0.004
        )
        # While its pose is unknown: level, looking to where the simulated arm stands.
        level = [[0.0, 0.0, -1.0, 2.0], [1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.4], [0, 0, 0, 1]]
        _set_pose(self._camera, np.array(level))
        look = {"scale": 0.14, "thickness": 0.004, "color": (190, 196, 208)}
        scene.add_camera_frustum("/camera/view", *_VIEW, **look)
        self._measured = scene.add_icosphere(
            "/camera/measured", ball_radius_m, _MEASURED, visible=False
        )
        look = {"subdivisions": 2, "opacity": 0.3, "visible": False}
        self._predicted = scene.add_icosphere(
            "/camera/predicted", 1.25 * ball_radius_m, _PREDICTED, **look
        )
        self._axes = scene.add_frame(
            "/camera/tag", axes_length=0.08, axes_radius=0.004, visible=False
        )
        self._add_object(ball_radius_m)
        self._add_target(ball_radius_m)

    def _add_surroundings(self) -> None:
        scene = self._server.scene
        # No environment and no shadows: without a graphics card they cost a core or more.
        scene.configure_environment_map(hdri=None)
        scene.configure_default_lights(enabled=True, cast_shadow=False)
        scene.add_light_hemisphere("/sky", ground_color=(110, 112, 120), intensity=1.2)

    def _add_target(self, ball_radius_m: float) -> None:
        scene = self._server.scene
        name = "/target" if self._aims_camera else "/camera/target"
        self._target = scene.add_transform_controls(
            name,
            scale=0.16,
            line_width=3.0,
            disable_rotations=True,
            depth_test=False,
            visible=False,
        )
        if self._aims_camera:
            look = {"scale": 0.1, "thickness": 0.004, "color": TARGET_RGB}
            scene.add_camera_frustum(f"{name}/view", *_VIEW, **look)
        else:
            # Smaller than what is measured, which hides it once it is there.
            scene.add_icosphere(f"{name}/ball", 0.6 * ball_radius_m, TARGET_RGB, opacity=0.8)
        self._target_axes = scene.add_frame(
            f"{name}/axes", axes_length=0.08, axes_radius=0.003, visible=False
        )

        @self._target.on_update
        async def _(event: viser.TransformControlsEvent) -> None:
            # In the page's thread; assignments of numbers alone.
            self._held_s["target"] = time.monotonic()
            if event.phase != "start":
                target = _pose(event.target)
                if self._aims_camera:
                    target = target.inverse() @ _pose(self._object)
                numbers = (*target.translation(), *target.rotation().wxyz)
                self._on_drag(Action("target", tuple(float(number) for number in numbers)))

    def _add_object(self, ball_radius_m: float) -> None:
        scene = self._server.scene
        # In the robot's root link, so that it is dragged along table and vertical.
        self._object = scene.add_transform_controls(
            "/object", scale=0.12, line_width=3.0, depth_test=False, visible=False
        )
        if self._kind.on_arm and not self._turns:
            scene.add_icosphere("/object/ball", ball_radius_m, _OBJECT)
        else:
            scene.add_box("/object/plate", color=_OBJECT, dimensions=(0.08, 0.08, 0.004))
            scene.add_frame("/object/axes", axes_length=0.08, axes_radius=0.003)

        @self._object.on_update
        async def _(event: viser.TransformControlsEvent) -> None:
            self._held_s["object"] = time.monotonic()
            if event.phase != "start":
                turned_deg = np.degrees(SO3(np.array(event.target.wxyz)).log())
                self._on_drag(Action(OBJECT_POSITION, tuple(map(float, event.target.position))))
                self._on_drag(Action(OBJECT_ROTATION, tuple(turned_deg.tolist())))

    def set_arm(self, arm: Arm) -> None:
        """Show another robot, or the first."""
        if self._robot is not None:
            self._server.scene.remove_by_name("/robot/visual")  # and all that hangs on it
        self._arm, self._robot = arm, ViserUrdf(self._server, arm.urdf, root_node_name="/robot")

    def update(self, board: Board, now_s: float) -> None:
        """Show a moment."""
        joints = board.newest("joint_states", now_s)
        if self._robot is not None and self._arm is not None and joints is not None:
            self._robot.update_cfg(self._arm.configuration(joints))
        if self._arm is not None and board.camera is not None:
            _set_pose(self._camera, self._arm.in_root(*board.camera))
            self._root.visible = True
        controller, z = board.controller(now_s), board.newest("feature", now_s)
        _put(self._predicted, controller.position_m)
        if z is not None and self._turns:
            self._axes.wxyz = SO3.from_matrix(self._kind.rotation(z)).wxyz
            self._target.disable_rotations, self._target_axes.visible = False, True
        if not self._kind.on_arm:  # else the object shows it
            _put(self._measured, None if z is None else z[:3])
            _put(self._axes, z[:3] if z is not None and self._turns else None)
        # After a drag they stay where they were dropped until the nodes have answered.
        held_since_s = time.monotonic() - 0.6
        if self._held_s["object"] < held_since_s:
            self._show_object(board, now_s)
        if self._held_s["target"] < held_since_s:
            self._show_target(controller.target_m, controller.target_wxyz)

    def _show_target(self, position_m: np.ndarray | None, wxyz: np.ndarray) -> None:
        if self._aims_camera and position_m is not None:
            if not (self._object.visible and np.isfinite(wxyz).all()):
                position_m = None
            else:
                seen = SE3.from_rotation_and_translation(SO3(wxyz), position_m)
                wanted = _pose(self._object) @ seen.inverse()
                position_m, wxyz = wanted.translation(), wanted.rotation().wxyz
        _put(self._target, position_m)
        if np.isfinite(wxyz).all():
            self._target.wxyz = wxyz

    def _show_object(self, board: Board, now_s: float) -> None:
        """Show it as measured; a simulated one that is not seen, where the simulator put it.

        To a camera on the arm it stays where it was seen last, or was dragged to.
        """
        z, put = board.newest("object", now_s), board.parameter(*OBJECT_POSITION.split("/"))
        on_arm, gizmo = self._kind.on_arm, self._object
        simulated = put is not None and (
            on_arm or board.parameter(topics.SIM, "object_tag_id") >= 0
        )
        gizmo.disable_axes = gizmo.disable_sliders = not simulated
        gizmo.disable_rotations = not simulated or (on_arm and not self._turns)
        if on_arm and z is None:
            return
        rotation, position_m = SO3.identity(), None
        if simulated and not on_arm:
            turned_deg = board.parameter(*OBJECT_ROTATION.split("/"))
            rotation, position_m = SO3.exp(np.radians(turned_deg)), np.array(put)
        if z is not None:
            camera, turned = SO3(np.array(self._camera.wxyz)), self._kind.rotation(z)
            position_m = self._camera.position + camera @ z[:3]
            rotation = rotation if turned is None else camera @ SO3.from_matrix(turned)
        gizmo.wxyz = rotation.wxyz
        _put(gizmo, position_m)


def _set_pose(node: viser.SceneNodeHandle, pose: np.ndarray) -> None:
    node.wxyz, node.position = SO3.from_matrix(pose[:3, :3]).wxyz, pose[:3, 3]


def _pose(node: viser.SceneNodeHandle) -> SE3:
    return SE3(np.concatenate([node.wxyz, node.position]))


def _put(node: viser.SceneNodeHandle, position_m: np.ndarray | None) -> None:
    node.visible = position_m is not None
    if position_m is not None:
        node.position = position_m


# --- the robot's model ---


class Arm:
    """A robot read from URDF, as its driver publishes it; a ``ValueError`` if it is none.

    ``names`` are its n joints in kinematic order.
    """

    def __init__(self, text: str, names: Sequence[str]) -> None:
        self.names = tuple(names)
        # Its warnings apply to every robot's URDF.
        logging.getLogger("yourdfpy").setLevel(logging.ERROR)
        try:
            root = read_robot(text)
            #: A sentence on meshes that are not here, if some are not.
            self.missing = find_meshes(root)
            self.urdf = yourdfpy.URDF.load(
                io.BytesIO(ET.tostring(root)),
                filename_handler=lambda fname: fname.removeprefix("file://"),
            )
        except Exception as error:  # readers of XML and meshes raise various ones
            raise ValueError(f"robot_description cannot be read: {error}") from error
        unknown = [name for name in names if name not in self.urdf.joint_map]
        if unknown:
            raise ValueError(f"robot_description has no joint {', '.join(unknown)}")

    def configuration(self, joints_rad: np.ndarray) -> dict[str, float]:
        """Joint positions by name, of positions in kinematic order, rad, shape (n,)."""
        return {name: float(angle) for name, angle in zip(self.names, joints_rad, strict=True)}

    def in_root(self, frame: str, pose: np.ndarray) -> np.ndarray:
        """A pose in a link's frame, (4, 4), m, in the model's root; of another frame, as it is."""
        return self.urdf.get_transform(frame) @ pose if frame in self.urdf.link_map else pose
