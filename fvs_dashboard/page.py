"""The page: a viser server with a 3-D view, a panel and curves."""

from __future__ import annotations

import contextlib
import errno
import io
import math
import socket
import threading
from typing import TYPE_CHECKING

import viser

from fvs_dashboard import markup
from fvs_dashboard.actions import Action, Actions
from fvs_dashboard.board import Board
from fvs_dashboard.charts import Charts
from fvs_dashboard.config import VISER
from fvs_dashboard.guard import EVERYWHERE, LOOPBACK, own_requests_only, turns_others_away
from fvs_dashboard.panel import Panel
from fvs_dashboard.scene import LEGEND, Scene

if TYPE_CHECKING:
    from fvs_dashboard.arm import Arm

#: The left panel is drawn every so many times, for curves are long and eyes are slow.
_SELDOM = 3
_STOP_S = 0.8
_LEFT_PX, _RIGHT_PX = 400, 350
_LAST_PORT = 65535
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
    host : str
        Address to serve at.
    port : int
        Its port; 0 for any free one.
    actions : Actions
        Takes what a person does.
    ball_radius_m : float
        Radius of the ball, m.
    image : bool
        Whether there will be a picture.
    tour : bool
        Whether a tour can be had.

    Raises
    ------
    ValueError
        If the port is taken, the address is not this machine's, or other sites would be let in.
    """

    def __init__(
        self,
        host: str,
        port: int,
        actions: Actions,
        *,
        ball_radius_m: float,
        image: bool,
        tour: bool,
    ) -> None:
        _check_free(host, port)
        self._host = host
        with _quiet(), own_requests_only(host):
            self._server = _Server(host, port, label="fvs_ros", verbose=False)
        if not turns_others_away(self._reached_at, self._server.get_port()):
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
        self._panel = Panel(gui, actions.put, image, tour)
        curves = gui.add_panel()
        with curves.add_tab("Curves", viser.Icon.CHART_LINE):
            self._charts = Charts(gui)
            self._inputs = gui.add_html("")
            gui.add_html(markup.legend_html(LEGEND))
            self._notes = gui.add_html("")
        curves.dock_left()
        curves.set_width(_LEFT_PX)
        self._scene = Scene(server, ball_radius_m, lambda at: self._dragged(actions, at))
        # From behind the simulator's camera: what one sees and its picture are the same way round.
        server.initial_camera.position = (2.9, -1.05, 1.4)
        server.initial_camera.look_at = (0.6, -0.3, 0.42)
        server.initial_camera.fov = _FIELD_RAD
        server.on_client_connect(_fit)
        self._shown = 0

    def _dragged(self, actions: Actions, target_m: tuple[float, float, float]) -> None:
        self._panel.forget_typed()
        actions.put(Action("target", target_m))

    @property
    def _reached_at(self) -> str:
        return "localhost" if self._host in EVERYWHERE else self._host

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
        """Whether anybody is looking."""
        return bool(self._server.get_clients())

    def set_arm(self, arm: Arm) -> None:
        """Show a robot."""
        self._scene.set_arm(arm)

    def update(self, board: Board, now_s: float) -> None:
        """Show a moment, steady clock, s, to everybody who is looking."""
        with self._server.atomic():
            picture = board.picture(now_s)
            self._panel.update(board, now_s, picture)
            self._scene.update(board, now_s, picture)
            if self._shown % _SELDOM == 0:
                self._charts.update(board, now_s)
                lamps, details = markup.lamps_of(board, now_s), markup.details_of(board, now_s)
                self._inputs.content = markup.inputs_html(lamps, details)
                self._notes.content = markup.notes_html(board.notes(now_s))
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


def _taken(host: str, port: int) -> str:
    return (
        f"port {port} of {host} is taken; stop what is served there, or choose another one: "
        f"-p port:={port + 1 if port < _LAST_PORT else 0}, or -p port:=0 for any that is free "
        "(after --ros-args, if fvs_dashboard is called by itself)"
    )


def _check_free(host: str, port: int) -> None:
    """Refuse a port that is taken: viser would quietly take the next one."""
    try:
        found = socket.getaddrinfo(host or None, port, type=socket.SOCK_STREAM)
        family, kind, protocol, _, address = found[0]
        with socket.socket(family, kind, protocol) as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind(address)
    except socket.gaierror as error:
        raise ValueError(f"host {host} is not known: {error}") from error
    except PermissionError as error:
        raise ValueError(f"port {port} is the system's: choose one from 1024 on") from error
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise ValueError(_taken(host, port)) from error
        raise ValueError(f"the page cannot be served at {host}: {error}") from error


def _quiet() -> contextlib.redirect_stdout:
    """Keep viser's own words from the terminal: the node says where the page is."""
    return contextlib.redirect_stdout(io.StringIO())
