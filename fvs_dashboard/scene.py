"""The 3-D view: arm, camera, ball, trail and target."""

from __future__ import annotations

import time
from collections.abc import Callable
from math import inf
from typing import TYPE_CHECKING

import numpy as np
import viser
from viser.extras import ViserUrdf
from viser.transforms import SO3

from fvs_dashboard.board import Board
from fvs_sim_node.objects import TABLE

if TYPE_CHECKING:
    from fvs_dashboard.arm import Arm  # a second to import, and not needed at the start

_BALL, _PREDICTED, _TARGET = (213, 40, 30), (255, 214, 0), (86, 180, 233)
#: What the colours mean in the view.
LEGEND = (
    ("●", _BALL, "ball seen"),
    ("◉", _PREDICTED, "where it is now"),
    ("●", _TARGET, "target: drag it"),
)
_ROD = (150, 156, 168)
_TRAIL_OLD, _TRAIL_NEW = np.array([60, 64, 72]), np.array([255, 214, 0])
#: A fixed number of pieces: the browser redraws the trail cheaply then.
_PIECES = 96
#: The target is smaller than the ball, which hides it once it is there.
_TARGET_SHARE = 0.6
#: After a drag the target stays where it was dropped, until the controller has answered, s.
_DROPPED_S = 0.6
_FRUSTUM_M = 0.14
#: The table is light; the page is dark.
_DIM = 0.45


class Scene:
    """All that stands in the 3-D view; what the camera sees stands in the camera's frame.

    Parameters
    ----------
    server : viser.ViserServer
        The page's server.
    ball_radius_m : float
        Radius of the ball, m.
    on_drag : callable
        Called with the target's position, camera frame, m, while it is dragged and when let go.
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
        self._frustum = scene.add_camera_frustum(
            "/base/camera/view",
            1.0,
            1.0,
            scale=_FRUSTUM_M,
            thickness=0.004,
            color=(190, 196, 208),
            jpeg_quality=70,
        )
        self._trail = self._add_lines("/base/camera/trail", _trail_colours(), 3.0)
        # How the ball is held is not known; that it is, is drawn.
        self._rod = self._add_lines("/base/camera/rod", np.full((1, 2, 3), _ROD), 5.0)
        self._ball = scene.add_icosphere("/base/camera/ball", ball_radius_m, _BALL, visible=False)
        self._predicted = scene.add_icosphere(
            "/base/camera/predicted",
            1.25 * ball_radius_m,
            _PREDICTED,
            subdivisions=2,
            opacity=0.3,
            visible=False,
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
            scene.add_box(
                f"/base/table/{number}",
                tuple(round(255 * _DIM * part) for part in thing.rgba[:3]),
                thing.size_m,
                position=thing.position_m,
            )
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
        scene.add_icosphere(
            "/base/camera/target/ball", _TARGET_SHARE * ball_radius_m, _TARGET, opacity=0.8
        )
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
        self._table.visible = placement.told
        self._floor.position = (0.0, 0.0, self._under_table_m if placement.told else 0.0)
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
    where = np.linspace(0.0, len(trail_m) - 1.0, _PIECES + 1)
    known = np.arange(len(trail_m))
    points = np.stack([np.interp(where, known, column) for column in trail_m.T], axis=1)
    return np.stack([points[:-1], points[1:]], axis=1)


def _trail_colours() -> np.ndarray:
    share = np.linspace(0.0, 1.0, _PIECES + 1)[:, None]
    colours = (1.0 - share) * _TRAIL_OLD + share * _TRAIL_NEW
    return np.stack([colours[:-1], colours[1:]], axis=1)
