"""The page: a viser server with a 3-D view, a panel and curves."""

from __future__ import annotations

import contextlib
import errno
import io
import math
import socket
import threading
from collections.abc import Sequence

import viser

from fvs_dashboard import markup
from fvs_dashboard.actions import Action, Actions
from fvs_dashboard.board import Board
from fvs_dashboard.charts import Charts
from fvs_dashboard.config import VISER, DashboardConfig
from fvs_dashboard.guard import EVERYWHERE, LOOPBACK, own_requests_only, turns_others_away
from fvs_dashboard.panel import Panel
from fvs_dashboard.picture import Picture
from fvs_dashboard.scene import LEGEND, Scene

#: The left panel is drawn every third time: its curves are long and change slowly.
_SELDOM = 3
_STOP_S = 0.8
_LEFT_PX, _RIGHT_PX = 400, 350
#: The first look: its field of view from top to bottom, rad, and the least width over height at
#: which arm, ball and camera are in it.
_FIELD_RAD, _LEAST_ASPECT = 0.7, 0.78


class _Server(viser.ViserServer):
    """viser's server, which stays on this host: any browser could ask for a public tunnel to it."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse."""
        return None


class Page:
    """Serves the page; what a person does there goes into ``actions``.

    Parameters
    ----------
    config : DashboardConfig
        Address, port, the ball's radius, and whether a tour can be had.
    joint_names : sequence of str
        Kinematic order.
    actions : Actions
        Takes what a person does.

    Raises
    ------
    ValueError
        If the port is taken, the address is not this machine's, or other sites would be let in.
    """

    def __init__(
        self, config: DashboardConfig, joint_names: Sequence[str], actions: Actions
    ) -> None:
        self._host, self._actions = config.host, actions
        _check_free(config.host, config.port)
        with _quiet(), own_requests_only(config.host):
            self._server = _Server(config.host, config.port, label="fvs_ros", verbose=False)
        reached_at = "localhost" if config.host in EVERYWHERE else config.host
        if not turns_others_away(reached_at, self._server.get_port()):
            self.close()
            raise ValueError(
                "the page would let any web site command the arm: the check of requests did not "
                f"take with viser {viser.__version__}; pip install '{VISER}'"
            )
        server, gui = self._server, self._server.gui
        gui.configure_theme(
            dark_mode=True, show_logo=False, show_share_button=False, brand_color=(0, 114, 178)
        )
        gui.main_panel.dock_right()
        gui.main_panel.set_width(_RIGHT_PX)
        self._panel = Panel(gui, actions.put, tour=bool(config.model_path))
        curves = gui.add_panel()
        with curves.add_tab("Curves", viser.Icon.CHART_LINE):
            self._charts = Charts(gui, joint_names)
            self._inputs = gui.add_html("")
            gui.add_html(markup.legend_html(LEGEND))
            self._notes = gui.add_html("")
        curves.dock_left()
        curves.set_width(_LEFT_PX)
        self.scene = Scene(server, config.ball_radius_m, self._dragged)
        # From behind the simulator's camera: what one sees and its picture are the same way round.
        server.initial_camera.position = (2.9, -1.05, 1.4)
        server.initial_camera.look_at = (0.6, -0.3, 0.42)
        server.initial_camera.fov = _FIELD_RAD
        server.on_client_connect(_fit)
        self._shown = 0

    def _dragged(self, target_m: tuple[float, float, float]) -> None:
        self._panel.forget_typed()
        self._actions.put(Action("target", target_m))

    @property
    def address(self) -> str:
        """Where a browser finds it."""
        host = socket.gethostname() if self._host in EVERYWHERE else self._host
        return f"http://{f'[{host}]' if ':' in host else host}:{self._server.get_port()}"

    @property
    def open_to_others(self) -> bool:
        """Whether it is served to more than this host."""
        return self._host.lower() not in LOOPBACK

    @property
    def watched(self) -> bool:
        """Whether a browser shows it."""
        return bool(self._server.get_clients())

    def update(self, board: Board, picture: Picture, now_s: float) -> None:
        """Show a moment, steady clock, s, in every browser."""
        with self._server.atomic():
            image = picture.newest(now_s, board.controller(now_s).target_m)
            self._panel.update(board, now_s, image)
            self.scene.update(board, now_s)
            self.scene.show_picture(picture.field_of_view, image)
            if self._shown % _SELDOM == 0:
                self._charts.update(board, now_s)
                lamps, details = markup.lamps_of(board, now_s), markup.details_of(board, now_s)
                self._inputs.content = markup.inputs_html(lamps, details)
                told = (board.newest(name, now_s) for name in ("arm", "behind"))
                notes = filter(None, (board.placement.note, *told))
                self._notes.content = markup.notes_html(notes)
        self._shown += 1

    def close(self) -> None:
        """Stop serving; a browser that does not answer is not waited for."""

        def stop() -> None:
            with _quiet():
                self._server.stop()

        thread = threading.Thread(target=stop, daemon=True)
        thread.start()
        thread.join(_STOP_S)


def field_of_view_rad(width: int, height: int) -> float:
    """The field of view from top to bottom, for a size in px: narrow ones see as much."""
    # Panels may leave nothing of a small window.
    wider = max(1.0, _LEAST_ASPECT * height / max(width, 0.2 * height, 1))
    return 2.0 * math.atan(wider * math.tan(0.5 * _FIELD_RAD))


async def _fit(client: viser.ClientHandle) -> None:
    """Keep the field of view right for the width that a browser leaves to the arm."""

    async def fit(camera: viser.CameraHandle) -> None:
        camera.fov = field_of_view_rad(camera.image_width, camera.image_height)

    client.camera.on_update(fit)
    await fit(client.camera)


def _check_free(host: str, port: int) -> None:
    """Refuse a port that is taken: viser would quietly take the next one."""
    try:
        found = socket.getaddrinfo(host or None, port, type=socket.SOCK_STREAM)
        family, kind, protocol, _, address = found[0]
        with socket.socket(family, kind, protocol) as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind(address)
    except OSError as error:
        if error.errno != errno.EADDRINUSE:
            raise ValueError(
                f"the page cannot be served at {host}, port {port}: {error}"
            ) from error
        raise ValueError(
            f"port {port} of {host} is taken; stop what is served there, or choose another one "
            "(-p port:=0 takes any; after --ros-args, if fvs_dashboard is called by itself)"
        ) from error


def _quiet() -> contextlib.redirect_stdout:
    """Keep viser's own words from the terminal: the node says where the page is."""
    return contextlib.redirect_stdout(io.StringIO())
