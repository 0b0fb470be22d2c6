"""The 3-D view: arm, camera, ball or tag, object, and target."""

from __future__ import annotations

import io
import logging
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from math import inf
from typing import Any

import numpy as np
import trimesh
import viser
import yourdfpy
from trimesh.visual.material import SimpleMaterial
from trimesh.visual.texture import TextureVisuals
from viser.extras import ViserUrdf
from viser.transforms import SE3, SO3

from fvs_dashboard.board import OBJECT_PLACE, Action, Board
from fvs_dashboard.picture import TARGET_RGB
from fvs_ros import topics
from fvs_ros.kinds import Kind
from fvs_ros.urdf import read_robot
from fvs_sim_node.config import TABLE
from fvs_sim_node.robot import find_meshes

_MEASURED, _PREDICTED, _OBJECT = (213, 40, 30), (255, 214, 0), (204, 121, 167)
#: Vertical angle of a RealSense's view, rad, and width over height.
_VIEW = 0.743, 4.0 / 3.0
#: The page is dark: shares of the brightness of the simulator's table and of the rod.
_DIM, _ROD = 0.6, (150, 156, 168)
_GIZMO: dict[str, Any] = {"line_width": 3.0, "depth_test": False, "visible": False}


def legend(kind: Kind) -> list[tuple[str, tuple[int, int, int], str]]:
    """What the colours mean in the view: signs, colours and words."""
    sign = "■" if kind.size > 3 else "●"
    measured = (sign, _OBJECT if kind.on_arm else _MEASURED, f"{kind.what}, measured")
    target = (sign, TARGET_RGB, "target: drag it")
    return [measured, ("◉", _PREDICTED, "predicted to now"), target]


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
        self._joints_mrad = np.zeros(0)
        self._arm: Arm | None = None
        self._robot: ViserUrdf | None = None
        scene = server.scene
        self._root = scene.add_frame("/robot", show_axes=False, visible=False)
        self._add_surroundings()
        self._camera = scene.add_frame(
            "/camera", axes_length=0.08, axes_radius=0.003, origin_radius=0.004
        )
        # While its pose is unknown: level, looking to where the simulated arm stands.
        level = [[0.0, 0.0, -1.0, 2.0], [1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.4], [0, 0, 0, 1]]
        _put(self._camera, SE3.from_matrix(np.array(level)))
        look = {"scale": 0.1, "thickness": 0.003, "color": (190, 196, 208)}
        scene.add_camera_frustum("/camera/view", *_VIEW, **look)
        self._measured = scene.add_frame("/camera/measured", show_axes=False, visible=False)
        self._add_body("/camera/measured", ball_radius_m, _MEASURED)
        look = {"subdivisions": 2, "opacity": 0.3, "visible": False}
        radius_m = ball_radius_m * (0.4 if self._turns else 1.25)  # a tag is not hidden by it
        self._predicted = scene.add_icosphere("/camera/predicted", radius_m, _PREDICTED, **look)
        self._add_object(ball_radius_m)
        self._add_target(ball_radius_m)

    def _add_surroundings(self) -> None:
        scene = self._server.scene
        # No environment and no shadows: without a graphics card they cost a core or more.
        scene.configure_environment_map(hdri=None)
        scene.configure_default_lights(enabled=True, cast_shadow=False)
        scene.add_light_ambient("/sky", intensity=0.5)
        # What the simulated camera sees around the arm; a real one's surroundings are unknown.
        self._table = scene.add_frame("/robot/table", show_axes=False, visible=False)
        for i, each in enumerate(TABLE):
            colour = tuple(round(255 * _DIM * part) for part in each.rgba[:3])
            name = f"/robot/table/{i}"
            scene.add_box(name, colour, each.size_m, position=each.position_m)
        look: dict[str, Any] = {"cell_color": (44, 48, 56), "section_color": (70, 76, 88)}
        look |= {"cell_size": 0.1, "section_size": 0.5, "shadow_opacity": 0.0}
        self._grid = scene.add_grid("/robot/grid", 4.0, 4.0, **look)
        self._floor_m = min(each.position_m[2] - 0.5 * each.size_m[2] for each in TABLE)
        nothing = np.zeros((1, 2, 3))
        self._rod = scene.add_line_segments("/robot/rod", nothing, _ROD, thickness=0.014)

    def _add_body(self, name: str, ball_radius_m: float, colour: tuple[int, int, int]) -> None:
        """Draw a ball or, of what turns, a plate with axes."""
        if not self._turns:
            self._server.scene.add_icosphere(f"{name}/ball", ball_radius_m, colour)
            return
        edge_m = 2.0 * ball_radius_m
        self._server.scene.add_box(f"{name}/plate", colour, (edge_m, edge_m, 0.004))
        look = {"axes_length": edge_m, "axes_radius": 0.003}
        self._server.scene.add_frame(f"{name}/axes", **look)

    def _add_target(self, ball_radius_m: float) -> None:
        scene = self._server.scene
        name = "/target" if self._aims_camera else "/camera/target"
        free = {"disable_rotations": not self._turns, **_GIZMO}
        self._target = scene.add_transform_controls(name, scale=0.16, **free)
        if self._aims_camera:
            look = {"scale": 0.1, "thickness": 0.004, "color": TARGET_RGB}
            scene.add_camera_frustum(f"{name}/view", *_VIEW, **look)
        else:
            # Smaller than what is measured, which hides it once it is there.
            self._add_body(name, 0.6 * ball_radius_m, TARGET_RGB)

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
        # In the robot's root link, so that it is dragged along table and vertical.
        self._object = self._server.scene.add_transform_controls("/object", scale=0.12, **_GIZMO)
        self._add_body("/object", ball_radius_m, _OBJECT)

        @self._object.on_update
        async def _(event: viser.TransformControlsEvent) -> None:
            self._held_s["object"] = time.monotonic()
            if event.phase != "start":
                pose = _pose(event.target)
                place = pose.translation(), np.degrees(pose.rotation().log())
                for name, numbers in zip(OBJECT_PLACE, place, strict=True):
                    self._on_drag(Action(f"{topics.SIM}/{name}", tuple(numbers.tolist())))

    def set_arm(self, arm: Arm) -> None:
        """Show another robot, or the first, and look at it from beside the simulator's camera."""
        bounds_m, camera = arm.urdf.scene.bounds, self._server.initial_camera
        reach_m = max(0.6, 0.0 if bounds_m is None else np.abs(bounds_m).max())
        camera.look_at = tuple(reach_m * np.array([0.45, 0.0, 0.15]))
        camera.position = tuple(reach_m * np.array([1.1, -2.2, 1.1]))
        camera.fov = 0.8
        if self._robot is not None:
            self._server.scene.remove_by_name("/robot/visual")  # and all that hangs on it
        self._arm, self._robot = arm, ViserUrdf(self._server, arm.urdf, root_node_name="/robot")

    def update(self, board: Board, now_s: float) -> None:
        """Show a moment."""
        joints = board.newest("joint_states", now_s)
        if self._robot is not None and self._arm is not None and joints is not None:
            angles_rad = map(float, joints)
            self._robot.update_cfg(dict(zip(self._arm.names, angles_rad, strict=False)))
        controller, z = board.controller(now_s), board.newest("feature", now_s)
        if self._arm is not None and board.camera is not None:
            _put(self._camera, SE3.from_matrix(self._arm.in_root(*board.camera)))
            self._root.visible = True
            if joints is not None:
                self._show_rod(joints, controller.position_m)
        self._table.visible = bool(board.parameters.get(topics.SIM))
        self._grid.position = (0.0, 0.0, self._floor_m * self._table.visible)
        predicted_m = controller.position_m
        _put(self._predicted, None if predicted_m is None else SE3.from_translation(predicted_m))
        if not self._kind.on_arm:  # else the object shows it
            _put(self._measured, None if z is None else self._pose_of(z))
        # After a drag they stay where they were dropped until the nodes have answered.
        held_since_s = time.monotonic() - 0.6
        if self._held_s["object"] < held_since_s:
            self._show_object(board, now_s)
        if self._held_s["target"] < held_since_s:
            self._show_target(controller.target(self._kind))

    def _show_rod(self, joints: np.ndarray, carried_m: np.ndarray | None) -> None:
        """Draw what holds the ball, tag or camera: how is not known, but that it is held.

        It is measured at rest: while the arm moves, joints and image are of different moments.
        """
        assert self._arm is not None
        flange, camera = SE3.from_matrix(self._arm.flange), _pose(self._camera)
        _put(self._rod, flange)
        before_mrad, self._joints_mrad = self._joints_mrad, np.round(1e3 * joints)
        still = np.array_equal(before_mrad, self._joints_mrad)
        if still and (self._kind.on_arm or carried_m is not None):
            end_m = camera.translation() if self._kind.on_arm else camera @ carried_m
            points_m = np.array([[np.zeros(3), flange.inverse() @ end_m]])
            if np.abs(points_m - self._rod.points).max() > 0.002:
                self._rod.points = points_m

    def _show_target(self, z: np.ndarray | None) -> None:
        pose = None if z is None else self._pose_of(z)
        if pose is not None and self._aims_camera:
            pose = _pose(self._object) @ pose.inverse() if self._object.visible else None
        _put(self._target, pose)

    def _pose_of(self, z: np.ndarray) -> SE3:
        """The pose of what is measured as z, (m,), in the camera's frame."""
        rotation = self._kind.rotation(z)
        turned = SO3.identity() if rotation is None else SO3.from_matrix(rotation)
        return SE3.from_rotation_and_translation(turned, z[:3])

    def _show_object(self, board: Board, now_s: float) -> None:
        """Show it as measured; a simulated one that is not seen, where the simulator put it.

        To a camera on the arm it stays where it was seen last, or was dragged to.
        """
        z = board.newest("object", now_s)
        put, turned_deg = (board.parameter(topics.SIM, name) for name in OBJECT_PLACE)
        on_arm, gizmo = self._kind.on_arm, self._object
        simulated = put is not None and (
            on_arm or board.parameter(topics.SIM, "object_tag_id") >= 0
        )
        gizmo.disable_axes = gizmo.disable_sliders = not simulated
        gizmo.disable_rotations = not simulated or (on_arm and not self._turns)
        if on_arm and z is None:
            return
        turned, pose = SO3.identity(), None
        if simulated and not on_arm:
            turned = SO3.exp(np.radians(turned_deg))
            pose = SE3.from_rotation_and_translation(turned, np.array(put))
        if z is not None:
            pose = _pose(self._camera) @ self._pose_of(z)
            if not self._turns:
                pose = SE3.from_rotation_and_translation(turned, pose.translation())
        _put(gizmo, pose)


def _pose(node: viser.SceneNodeHandle) -> SE3:
    return SE3(np.concatenate([node.wxyz, node.position]))


def _put(node: viser.SceneNodeHandle, pose: SE3 | None) -> None:
    node.visible = pose is not None
    if pose is not None:
        node.position, node.wxyz = pose.translation(), pose.rotation().wxyz


# --- the robot's model ---


def _paint(mesh: trimesh.Trimesh) -> None:
    """Say that it is no metal, which is black without surroundings to reflect."""
    visual: Any = mesh.visual
    if visual.kind != "texture":
        visual = mesh.visual = TextureVisuals(material=SimpleMaterial(diffuse=visual.main_color))
    if isinstance(visual.material, SimpleMaterial):
        visual.material = visual.material.to_pbr()
    if visual.material.metallicFactor is None:
        visual.material.metallicFactor = 0.0


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
            for mesh in self.urdf.scene.geometry.values():
                _paint(mesh)
        except Exception as error:  # readers of XML and meshes raise various ones
            raise ValueError(f"robot_description cannot be read: {error}") from error
        unknown = [name for name in names if name not in self.urdf.joint_map]
        if unknown:
            raise ValueError(f"robot_description has no joint {', '.join(unknown)}")

    @property
    def flange(self) -> np.ndarray:
        """Pose of the last joint's link in the model's root, (4, 4), m."""
        return self.urdf.get_transform(self.urdf.joint_map[self.names[-1]].child)

    def in_root(self, frame: str, pose: np.ndarray) -> np.ndarray:
        """A pose in a link's frame, (4, 4), m, in the model's root; of another frame, as it is."""
        return self.urdf.get_transform(frame) @ pose if frame in self.urdf.link_map else pose
