"""The 3-D view: arm, camera, ball, trail and target."""

from __future__ import annotations

import io
import logging
import os
import time
from collections.abc import Callable, Sequence
from math import inf
from pathlib import Path

import numpy as np
import trimesh
import viser
import yourdfpy
from viser.extras import ViserUrdf
from viser.transforms import SO3

from fvs_dashboard.board import Board
from fvs_sim_node.config import TABLE

_BALL, _PREDICTED, _TARGET = (213, 40, 30), (255, 214, 0), (86, 180, 233)
#: What the colours mean in the view.
LEGEND = (
    ("●", _BALL, "ball seen"),
    ("◉", _PREDICTED, "where it is now"),
    ("●", _TARGET, "target: drag it"),
)
_ROD = (150, 156, 168)
#: Of the trail, from old to new: a fixed number, which the browser redraws cheaply.
_TRAIL_COLOURS = np.linspace((60, 64, 72), (255, 214, 0), 97)
#: After a drag the target stays where it was dropped, until the controller has answered, s.
_DROPPED_S = 0.6


class Scene:
    """All that stands in the 3-D view; what the camera sees stands in the camera's frame.

    ``on_drag`` gets the target's position, camera frame, m, while it is dragged and when let go.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        ball_radius_m: float,
        on_drag: Callable[[tuple[float, float, float]], None],
    ) -> None:
        self._server = server
        self._on_drag = on_drag
        self._held_s = -inf  # when a person last held the target
        self._arm: Arm | None = None
        self._robot: ViserUrdf | None = None
        self._add_surroundings()
        scene = server.scene
        scene.add_frame("/robot", show_axes=False)
        self._camera = scene.add_frame(
            "/base/camera", axes_length=0.08, axes_radius=0.003, origin_radius=0.004, visible=False
        )
        look = {"scale": 0.14, "thickness": 0.004, "color": (190, 196, 208), "jpeg_quality": 70}
        self._frustum = scene.add_camera_frustum("/base/camera/view", 1.0, 1.0, **look)
        self._trail = self._add_lines("/base/camera/trail", _joined(_TRAIL_COLOURS), 3.0)
        # How the ball is held is not known; that it is, is drawn.
        self._rod = self._add_lines("/base/camera/rod", np.full((1, 2, 3), _ROD), 5.0)
        self._ball = scene.add_icosphere("/base/camera/ball", ball_radius_m, _BALL, visible=False)
        look = {"subdivisions": 2, "opacity": 0.3, "visible": False}
        self._predicted = scene.add_icosphere(
            "/base/camera/predicted", 1.25 * ball_radius_m, _PREDICTED, **look
        )
        self._add_target(ball_radius_m)

    def _add_surroundings(self) -> None:
        """Light, floor, and what the simulated camera sees around the arm."""
        scene = self._server.scene
        # No environment and no shadows: where no graphics card draws, they cost a core or more.
        scene.configure_environment_map(hdri=None)
        scene.configure_default_lights(enabled=True, cast_shadow=False)
        scene.add_light_hemisphere("/sky", ground_color=(110, 112, 120), intensity=1.2)
        self._floor = scene.add_grid(
            "/floor",
            width=3.0,
            height=3.0,
            cell_size=0.1,
            cell_color=(52, 56, 64),
            section_size=0.5,
            section_color=(84, 90, 102),
            shadow_opacity=0.0,
        )
        self._base = scene.add_frame("/base", show_axes=False)
        # The simulator's world is ROS's base_link, turned by half a turn.
        self._table = scene.add_frame(
            "/base/table", show_axes=False, wxyz=(0.0, 0.0, 0.0, 1.0), visible=False
        )
        for number, thing in enumerate(TABLE):
            # The table is light; the page is dark.
            colour = tuple(round(0.45 * 255 * part) for part in thing.rgba[:3])
            name = f"/base/table/{number}"
            scene.add_box(name, colour, thing.size_m, position=thing.position_m)
        self._under_table_m = min(one.position_m[2] - 0.5 * one.size_m[2] for one in TABLE)

    def _add_lines(
        self, name: str, colours: np.ndarray, thickness: float
    ) -> viser.LineSegmentsHandle:
        return self._server.scene.add_line_segments(
            name,
            np.zeros(colours.shape),
            colours.astype(np.uint8),
            thickness=thickness,
            thickness_units="screen",
            visible=False,
        )

    def _add_target(self, ball_radius_m: float) -> None:
        scene = self._server.scene
        self._target = scene.add_transform_controls(
            "/base/camera/target",
            scale=0.16,
            line_width=3.0,
            disable_rotations=True,
            depth_test=False,
            visible=False,
        )
        # Smaller than the ball, which hides it once it is there.
        scene.add_icosphere("/base/camera/target/ball", 0.6 * ball_radius_m, _TARGET, opacity=0.8)
        scene.add_label(
            "/base/camera/target/name",
            "target",
            position=(0.0, -0.07, 0.0),
            anchor="bottom-center",
            font_screen_scale=0.8,
        )

        @self._target.on_update
        async def _(event: viser.TransformControlsEvent) -> None:
            # In the page's thread; assignments of numbers alone.
            self._held_s = time.monotonic()
            if event.phase != "start":
                x, y, z = (float(value) for value in event.target.position)
                self._on_drag((x, y, z))

    def set_arm(self, arm: Arm) -> None:
        """Show another robot, or the first."""
        if self._robot is not None:
            self._server.scene.remove_by_name("/robot/visual")  # and all that hangs on it
        self._arm, self._robot = arm, ViserUrdf(self._server, arm.urdf, root_node_name="/robot")
        _place(self._base, arm.base)

    def update(self, board: Board, now_s: float) -> None:
        """Show a moment."""
        joints, placement = board.newest("joint_states", now_s), board.placement
        if self._robot is not None and self._arm is not None and joints is not None:
            self._robot.update_cfg(self._arm.configuration(joints))
        self._table.visible = placement.true
        self._floor.position = (0.0, 0.0, self._under_table_m if placement.true else 0.0)
        camera = placement.pose
        self._camera.visible = camera is not None
        if camera is None:
            return
        _place(self._camera, camera)
        controller, ball_m = board.controller(now_s), board.newest("ball_position", now_s)
        _put(self._ball, ball_m)
        _put(self._predicted, controller.position_m)
        if time.monotonic() - self._held_s > _DROPPED_S:
            _put(self._target, controller.target_m)
        self._rod.visible = self._arm is not None and joints is not None and ball_m is not None
        if self._arm is not None and joints is not None and ball_m is not None:
            flange_m = self._arm.flange(joints)[:3, 3]
            self._rod.points = np.array([[(flange_m - camera[:3, 3]) @ camera[:3, :3], ball_m]])
        trail_m = board.trail_m.window(now_s)[:, 1:]
        self._trail.visible = len(trail_m) > 1
        if len(trail_m) > 1:
            self._trail.points = _pieces(trail_m)

    def show_picture(self, field_of_view: tuple[float, float], image: np.ndarray | None) -> None:
        """Show a new picture in the camera's view: vertical angle, rad, and width over height."""
        self._frustum.fov, self._frustum.aspect = field_of_view
        if image is not None:
            self._frustum.image = image


def _place(node: viser.SceneNodeHandle, pose: np.ndarray) -> None:
    node.wxyz, node.position = SO3.from_matrix(pose[:3, :3]).wxyz, pose[:3, 3]


def _put(node: viser.SceneNodeHandle, position_m: np.ndarray | None) -> None:
    node.visible = position_m is not None
    if position_m is not None:
        node.position = position_m


def _pieces(trail_m: np.ndarray) -> np.ndarray:
    """The trail in equal parts of time, oldest first, shape (pieces, 2, 3)."""
    where = np.linspace(0.0, len(trail_m) - 1.0, len(_TRAIL_COLOURS))
    known = np.arange(len(trail_m))
    return _joined(np.stack([np.interp(where, known, one) for one in trail_m.T], axis=1))


def _joined(points: np.ndarray) -> np.ndarray:
    """Each of some points, shape (n, 3), with the next one, shape (n - 1, 2, 3)."""
    return np.stack([points[:-1], points[1:]], axis=1)


# --- the robot's model ---

_PACKAGE = "package://"
#: Where ROS is installed, if it is: programs that sourced none find its meshes, too.
_INSTALLED = Path("/opt/ros")
#: How thick a bar is, m, and its colour; a link that is shorter gets none.
_BAR_RADIUS_M, _SHORTEST_M = 0.03, 1e-3
_BAR_COLOUR = (204, 209, 217, 255)


class Arm:
    """A robot read from URDF, as its driver publishes it; a ``ValueError`` if it is none.

    ``names`` are its n joints in kinematic order, ``tf_prefix`` stands before its links' names.
    """

    def __init__(self, text: str, names: Sequence[str], tf_prefix: str = "") -> None:
        self.names = tuple(names)
        #: Its model, and a sentence about shapes that could not be had: bars stand for them.
        self.urdf, self.missing = _load(text)
        unknown = [name for name in names if name not in self.urdf.joint_map]
        if unknown:
            raise ValueError(f"robot_description has no joint {', '.join(unknown)}")
        links = self.urdf.link_map
        flange, base = f"{tf_prefix}tool0", f"{tf_prefix}base_link"
        self._flange = flange if flange in links else self.urdf.joint_map[names[-1]].child
        self._base = base if base in links else self.urdf.base_link
        self._add_bars()

    def configuration(self, joints_rad: np.ndarray) -> dict[str, float]:
        """Joint positions by name, of positions in kinematic order, rad, shape (n,)."""
        return {name: float(angle) for name, angle in zip(self.names, joints_rad, strict=True)}

    def flange(self, joints_rad: np.ndarray) -> np.ndarray:
        """Pose of the flange in ``base_link``, shape (4, 4), m."""
        self.urdf.update_cfg(self.configuration(joints_rad))
        return self.urdf.get_transform(self._flange, self._base)

    @property
    def base(self) -> np.ndarray:
        """Pose of ``base_link`` in the model's root, shape (4, 4), m."""
        return self.urdf.get_transform(self._base)

    def _add_bars(self) -> None:
        """Draw a bar to the next joint for each link of the arm that has no shape here."""
        scene = self.urdf.scene
        drawn = {scene.graph.transforms.parents[name] for name in scene.graph.nodes_geometry}
        by_child = {joint.child: joint for joint in self.urdf.joint_map.values()}
        first, link = self.urdf.joint_map[self.names[0]].parent, self._flange
        while link != first and link in by_child:
            joint = by_child[link]
            link = joint.parent
            end_m = np.zeros(3) if joint.origin is None else joint.origin[:3, 3]
            if link in drawn or np.linalg.norm(end_m) < _SHORTEST_M:
                continue
            bar = trimesh.creation.cylinder(
                _BAR_RADIUS_M, segment=[np.zeros(3), end_m], sections=24
            ) + trimesh.creation.icosphere(2, 1.3 * _BAR_RADIUS_M).apply_translation(end_m)
            bar.visual.face_colors = _BAR_COLOUR
            name = f"{link}_bar"
            scene.add_geometry(bar, name, geom_name=name, parent_node_name=link)


def _load(text: str) -> tuple[yourdfpy.URDF, str]:
    """Read a URDF with those meshes that are here, and a sentence about the others."""
    # It warns of what every robot's URDF has, and of meshes that are not here.
    logging.getLogger("yourdfpy").setLevel(logging.ERROR)
    lost: list[str] = []

    def find(fname: str) -> str:
        path = _find(fname)
        if not Path(path).is_file():
            lost.append(fname)
        return path

    def load(meshes: bool) -> yourdfpy.URDF:
        source = io.BytesIO(text.encode("utf-8"))
        return yourdfpy.URDF.load(source, filename_handler=find, load_meshes=meshes)

    # Whatever its XML and mesh readers raise.
    try:
        return load(True), _about(lost)
    except Exception as error:
        try:
            return load(False), f"bars are drawn, for a mesh cannot be read: {error}"
        except Exception:
            raise ValueError(f"robot_description cannot be read: {error}") from error


def _about(lost: Sequence[str]) -> str:
    """What to say of meshes that are not here."""
    if not lost:
        return ""
    text = f"{len(set(lost))} meshes are not on this computer ({lost[0]}): bars are drawn instead"
    if not lost[0].startswith(_PACKAGE):
        return text
    package = lost[0].removeprefix(_PACKAGE).partition("/")[0]
    return (
        f"{text}; install ros-jazzy-{package.replace('_', '-')} (apt), or name the folder that "
        f"holds share/{package} in AMENT_PREFIX_PATH, and start this again"
    )


def _find(fname: str) -> str:
    """The file of a mesh that the URDF names."""
    if not fname.startswith(_PACKAGE):
        return fname.removeprefix("file://")
    inside = fname.removeprefix(_PACKAGE)
    sourced = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    prefixes = (*map(Path, filter(None, sourced)), *sorted(_INSTALLED.glob("*"), reverse=True))
    paths = (prefix / "share" / inside for prefix in prefixes)
    return str(next((path for path in paths if path.is_file()), inside))
