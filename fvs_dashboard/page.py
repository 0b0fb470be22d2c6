"""The page: a viser server with a 3-D view, a control panel, and curves."""

from __future__ import annotations

import contextlib
import io
import logging
import socket
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from itertools import cycle
from math import inf, nan
from typing import Any

import numpy as np
import viser
from viser import uplot
from viser.transforms import SO3

from fvs_controller_node.config import LAWS
from fvs_dashboard import markup, picture
from fvs_dashboard.board import HISTORY_S, REFERENCE, Action, Board
from fvs_dashboard.clicks import TRACK, Clicks
from fvs_dashboard.config import VISER, DashboardConfig
from fvs_dashboard.guard import EVERYWHERE, LOOPBACK, own_requests_only, turns_others_away
from fvs_dashboard.scene import Scene, legend
from fvs_dashboard.wall import Wall
from fvs_estimator_node.registry import ESTIMATORS
from fvs_ros import topics
from fvs_ros.kinds import Kind


class _Server(viser.ViserServer):
    """viser's server without its public tunnel, which any browser could request."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse."""
        return None


class Page:
    """Serves the page; ``act`` gets the user's actions, in the page's threads.

    Raises ``ValueError`` if the port is taken, if the address is not this machine's, or if other
    sites would have access.
    """

    def __init__(self, config: DashboardConfig, act: Callable[[Action], None]) -> None:
        self._host, self._act, self._kind = config.host, act, config.kind
        _check_free(config.host, config.port)
        logging.getLogger("websockets.server").setLevel(logging.CRITICAL)  # a tab that closes
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
        gui.main_panel.set_width(346)
        self._panel = Panel(gui, act, config)
        curves = gui.add_panel()
        with curves.add_tab("Curves", viser.Icon.CHART_LINE):
            self._charts = Charts(gui, self._kind)
            self._inputs = gui.add_html("")
            if self._kind.rigid:
                gui.add_html(markup.legend_html(legend(self._kind)))
        curves.dock_left()
        curves.set_width(376)
        self._shown = 0
        if not self._kind.rigid:
            self._wall = Wall(server, len(self._kind.cameras), self._panel.clicked)
            return
        self.scene = Scene(server, config.ball_radius_m, config.kind, self._dragged)

    def _dragged(self, action: Action) -> None:
        self._panel.forget_typed()
        self._act(action)

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

    def update(self, board: Board, pictures: Sequence[picture.Picture], now_s: float) -> None:
        """Show a moment, steady clock, s, in every browser, with the pictures of all cameras."""
        with self._server.atomic():
            self._panel.update(board, now_s, pictures)
            if self._kind.rigid:
                self.scene.update(board, now_s)
            else:
                self._show_wall(board, pictures, now_s)
            if self._shown % 4 == 0:  # the curves are long and change slowly
                self._charts.update(board, now_s)
                self._inputs.content = markup.inputs_html(board, self._kind, now_s)
        self._shown += 1

    def _show_wall(self, board: Board, pictures: Sequence[picture.Picture], now_s: float) -> None:
        targets_px = board.controller(now_s).target_px(self._kind)
        for camera, each in enumerate(pictures):
            aimed, z = self._panel.clicks.aimed.get(camera), board.newest("feature", now_s, camera)
            crosses_px = targets_px[camera] if aimed is None else np.array([aimed])
            circles_px = () if z is None else z.reshape(-1, 2)
            self._wall.update(camera, each, each.newest(crosses_px, circles_px))

    def close(self) -> None:
        """Stop serving; a browser that does not answer is not waited for long."""
        thread = threading.Thread(target=self._server.stop, daemon=True)
        with _quiet():
            thread.start()
            thread.join(0.8)


def _check_free(host: str, port: int) -> None:
    """Refuse a port that is taken: viser would quietly take the next one."""
    try:
        family, *_, address = socket.getaddrinfo(host or None, port, type=socket.SOCK_STREAM)[0]
        socket.create_server(address, family=family).close()
    except OSError as error:
        raise ValueError(
            f"the page cannot be served at {host}, port {port}: {error}; -p port:=0 takes any "
            "free port (after --ros-args, if fvs_dashboard is called by itself)"
        ) from error


def _quiet() -> contextlib.redirect_stdout:
    """Keep viser's own words from the terminal: the node says where the page is."""
    return contextlib.redirect_stdout(io.StringIO())


# --- the panel ---

#: Time that a user's input is not overwritten, s; longer for numbers that need a button press.
_SET_S, _TYPED_S = 4.0, 60.0


class Panel:
    """Start, Stop, banner, target, scheme, picture and the simulator's disturbances.

    Elements of variable height are below all buttons.
    """

    def __init__(
        self, gui: viser.GuiApi, act: Callable[[Action], None], config: DashboardConfig
    ) -> None:
        self._gui, self._act, self._kind = gui, act, config.kind
        self.clicks = Clicks(self._kind)
        self._held_until_s: dict[str, float] = {}
        self._settings: dict[str, viser.GuiInputHandle] = {}
        self._labels: dict[str, str] = {}  # names of references by the words on their buttons
        gui.add_html(markup.STYLE + markup.TOP_ROW)
        hint = "Lets the arm move to the target."
        self._button("Start", "start", color="teal", icon=viser.Icon.PLAYER_PLAY, hint=hint)
        hint = "Brings the arm to rest until the next start."
        self._button("Stop", "stop", color="red", icon=viser.Icon.PLAYER_STOP, hint=hint)
        self._alive = gui.add_html("")
        self._beat_s, self._beats = -inf, 0
        self._banner = gui.add_html("")
        signs = [("+", picture.TARGET_RGB, "target")]
        if self._kind.rigid:
            self._picture = gui.add_image(
                picture.blank(picture.PANEL_PX), format="jpeg", jpeg_quality=75
            )
        else:
            signs.append(("○", picture.MEASURED_RGB, "as measured"))
        self._words = gui.add_html("")
        gui.add_html(markup.legend_html(signs))
        tour = config.tour or bool(config.model_path)
        if self._kind.rigid:
            self._add_target(tour)
        else:
            self._add_aim(tour)
        self._add_references()
        with gui.add_folder("Scheme", expand_by_default=False):
            self._add_choice("Estimator", f"{topics.ESTIMATOR}/method", ESTIMATORS)
            self._add_choice("Law", f"{topics.CONTROLLER}/law", LAWS)
        row = gui.add_html(markup.ROW)
        hint = "Stops, forgets what was learned, and puts simulated arm and camera back."
        self._button("Reset", "reset", color="gray", hint=hint)
        hint = "Turns the simulated camera by a random angle: the arm must find its targets anew."
        bump = self._button("Bump the camera", "bump", color="gray", hint=hint)
        simulator = gui.add_folder("Simulator: disturb it", expand_by_default=False)
        with simulator:
            hint = "Times the depth camera's own noise."
            noise = gui.add_slider("Depth noise (×)", 0.0, 5.0, 0.1, 1.0, hint=hint)
            self._sets(f"{topics.SIM}/depth_noise", noise)
            latency = gui.add_slider("Latency (s)", 0.0, 0.2, 0.005, 0.04)
            self._sets(f"{topics.SIM}/latency_s", latency)
        self._simulated = (row, bump, simulator)  # shown beside a simulator only
        for element in self._simulated:
            element.visible = False

    def _button(
        self, label: str, action: str, value: viser.GuiTextHandle | None = None, **look: str
    ) -> viser.GuiButtonHandle:
        button = self._gui.add_button(label, **look)

        @button.on_click
        async def _(_event: viser.GuiEvent) -> None:
            if action in ("set_current_as_target", "reset"):
                self.forget_typed()
            self._act(Action(action, value and value.value))

        return button

    def _add_target(self, tour: bool) -> None:
        of_what = " of the object" * self._kind.on_arm
        with self._gui.add_folder(f"Target{of_what} in the camera's frame"):
            fields, start = {"x, y, z (m)": 0.001}, (0.0, 0.0, 0.0)
            if self._kind.size > 3:
                fields["turned about x, y, z (°)"] = 0.1
            add = self._gui.add_vector3
            self._add_go([add(name, start, step=step) for name, step in fields.items()], tour)

    def _add_aim(self, tour: bool) -> None:
        """The target in each camera's picture, and what a click there does."""
        gui, several = self._gui, self._kind.numbers > 2 * len(self._kind.cameras)
        with gui.add_folder("Target" + " of the first point" * several):
            hint = "Sets the target, or what the detector follows: any patch, as it looks now."
            words = "sets the target", "track this"
            self._click = gui.add_dropdown("A click", words, hint=hint)
            fields = [
                gui.add_vector2(f"{name} u, v (px)".strip(), (0.0, 0.0), step=0.1)
                for name in self._kind.cameras
            ]
            self._add_go(fields, tour)
            hint = "The detector looks for ball or tags again."
            undo = gui.add_button("Track nothing", color="gray", hint=hint)

        @undo.on_click
        async def _(_event: viser.GuiEvent) -> None:
            self.clicks.forget()
            self._act(Action(TRACK, ()))

    def _add_go(self, fields: list[Any], tour: bool) -> None:
        gui, self._fields = self._gui, fields
        gui.add_html(markup.ROW)
        hint = "Makes these numbers the target. The arm moves if it was started."
        go = gui.add_button("Go", color="blue", icon=viser.Icon.TARGET_ARROW, hint=hint)
        hint = "Makes where it is now the target."
        self._button("Set current as target", "set_current_as_target", color="gray", hint=hint)
        hint = "Sends a random target every five seconds."
        self._sets("tour", gui.add_checkbox("Tour", False, visible=tour, hint=hint))

        for field in fields:
            self._watch("target", field, _TYPED_S)

        @go.on_click
        async def _(_event: viser.GuiEvent) -> None:
            self.clicks.forget()
            self._hold("target", _SET_S)  # until the controller has taken it
            numbers = [float(value) for field in fields for value in field.value]
            if self._kind.rigid:
                numbers[3:] = SO3.exp(np.radians(numbers[3:])).wxyz.tolist() if numbers[3:] else []
            self._act(Action("target", tuple(numbers)))

    def clicked(self, camera: int, at_px: np.ndarray) -> None:
        """Take a click in a camera's picture."""
        self.forget_typed()
        track = self._click.value != self._click.options[0]
        action = self.clicks.take(camera, at_px.tolist(), track)
        if action is not None:
            self._act(action)

    def _add_references(self) -> None:
        gui = self._gui
        with gui.add_folder("Teach and repeat"):
            self._name = gui.add_text("Name", "", hint="Of what is taught, or gone to.")
            gui.add_html(markup.ROW)
            if self._kind.on_arm:
                hint = "Keeps where the camera is at rest, seen from the object."
            else:
                hint = "Keeps where the tool is at rest, seen from the object if one is seen."
            self._button("Teach", "teach", self._name, color="gray", hint=hint)
            hint = "Makes it the target, and starts the arm."
            self._button("Go there", "go", self._name, color="blue", hint=hint)
            self._reference = gui.add_html("")
            gui.add_html(markup.LIST)
            self._references = gui.add_button_group("Go to", ("",), visible=False, hint=hint)

        self._watch(REFERENCE, self._name, _TYPED_S)

        @self._references.on_click
        async def _(_event: viser.GuiEvent) -> None:
            self._name.value = self._labels[self._references.value]
            self._hold(REFERENCE, _SET_S)  # until the controller has taken it
            self._act(Action("go", self._name.value))

    def _add_choice(self, label: str, name: str, known: Mapping[str, type]) -> None:
        hint = markup.meanings(known)
        self._sets(name, self._gui.add_dropdown(label, tuple(known), hint=hint))

    def _sets(self, name: str, handle: viser.GuiInputHandle) -> None:
        """Forward the user's settings, and otherwise show the present value."""
        self._settings[name] = handle
        self._watch(name, handle, _SET_S)

    def _watch(self, name: str, handle: viser.GuiInputHandle, hold_s: float) -> None:
        """Do not overwrite what a user sets; forward it, if it is a setting."""

        @handle.on_update
        async def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                self._hold(name, hold_s)
                if name in self._settings:
                    self._act(Action(name, handle.value))

    def update(self, board: Board, now_s: float, pictures: Sequence[picture.Picture]) -> None:
        """Show a moment, and how old the pictures are."""
        if now_s - self._beat_s > 0.2 * markup.LOST_S:  # a heartbeat to the browser
            self._beat_s, self._beats = now_s, self._beats + 1
            self._alive.content = markup.alive_html(self._beats)
        self._banner.content = markup.banner_html(board, self._kind, now_s)
        controller, kind = board.controller(now_s), self._kind
        target = controller.target(kind)
        if kind.rigid:
            target_px = pictures[0].pixels(target)
            image = pictures[0].newest(target_px)
            if image is not None:
                self._picture.image = image
            self._words.content = markup.caption_html(pictures[0].words(now_s, target_px))
        else:
            targets_px = controller.target_px(kind)
            words = (p.words(now_s, px) for p, px in zip(pictures, targets_px, strict=True))
            named = zip(kind.cameras, words, strict=True)
            text = "; ".join(f"{name}: " * bool(name) + each for name, each in named if each)
            self._words.content = markup.line_html("next", self.clicks.words or text)
        shown = board.feature(now_s) if target is None else target  # to begin with
        if shown is not None and self._free("target"):
            for field, numbers in zip(self._fields, _typed(kind, shown), strict=True):
                field.value = tuple(numbers.tolist())
        self._show_references(board)
        for element in self._simulated:
            element.visible = bool(board.parameters.get(topics.SIM))
        for name, handle in self._settings.items():
            value = board.tour if name == "tour" else board.parameter(*name.split("/"))
            if isinstance(value, type(handle.value)) and self._free(name):
                handle.value = value

    def _show_references(self, board: Board) -> None:
        name, known = board.parameter(*REFERENCE.split("/")), board.references
        if isinstance(name, str) and self._free(REFERENCE):
            self._name.value = name
        chosen = known.get(self._name.value, board.references_problem)
        text = markup.reference_text(chosen, self._kind)
        self._reference.content = markup.line_html("reference", text)
        self._labels = markup.reference_labels(known)
        if self._labels and tuple(self._labels) != self._references.options:
            self._references.options = tuple(self._labels)
        self._references.visible = bool(self._labels)

    def forget_typed(self) -> None:
        """Show the controller's target again, and discard an unsent one."""
        self._held_until_s.pop("target", None)

    def _hold(self, name: str, seconds: float) -> None:
        """Do not overwrite a setting for some seconds, while the user edits it."""
        self._held_until_s[name] = time.monotonic() + seconds

    def _free(self, name: str) -> bool:
        """Whether the user is not editing the setting."""
        return time.monotonic() > self._held_until_s.get(name, -inf)


def _typed(kind: Kind, z: np.ndarray) -> list[np.ndarray]:
    """The fields of a target, (m,): position, m, and rotation vector, degrees; or first points."""
    if not kind.rigid:
        return list(np.round(z.reshape(len(kind.cameras), -1, 2)[:, 0], 1))
    rotation = kind.rotation(z)
    turned = [] if rotation is None else [np.round(np.degrees(SO3.from_matrix(rotation).log()), 1)]
    return [np.round(z[:3], 3), *turned]


# --- the curves ---


def _series(label: str, colour: str, width: float = 1.5) -> uplot.Series:
    return uplot.Series(label=label, stroke=colour, width=width, points={"show": False})


def _level(label: str) -> uplot.Series:
    return uplot.Series(**_series(label, markup.GREY, 1.0), dash=(6.0, 4.0))


def _logarithmic(least: float, most: float) -> dict:
    # Values without a logarithm are left out, not drawn as zero.
    return {"distr": 3, "log": 10, "range": (least, most), "clamp": "unknown"}


class Charts:
    """Error, joint speeds and prediction error over the last seconds."""

    def __init__(self, gui: viser.GuiApi, kind: Kind) -> None:
        self._gui = gui
        self._joint_names: Sequence[str] = ()
        self._limit_rad_s = nan
        self._nudge_s = 0.0
        unit, turns = "mm" if kind.rigid else "px", kind.rigid and kind.size > 3
        self._error = self._add(
            f"Distance to the target, {unit}" + ", and angle, °" * turns,
            _logarithmic(0.01, 1000.0),
            _series("estimated", "#F2F4F7", 2.25),
            _series("true (simulator)", markup.COLOURS[0]),
            *[_series("angle", markup.COLOURS[1])] * turns,
        )
        self._speed = self._add(
            "Joint speeds and their limit, rad/s",
            {"range": (0.0, 1.2)},
            _level("limit"),
        )
        self._ratio = self._add(
            "Prediction error of the Jacobian",
            _logarithmic(0.001, 10.0),
            _series("over that of predicting rest", markup.COLOURS[0], 2.0),
            _level("useless"),
        )

    def _add(self, title: str, scale: dict, *series: uplot.Series) -> viser.GuiUplotHandle:
        nothing = np.full(2, np.nan)
        axes = tuple(
            uplot.Axis(
                size=size, gap=gap, space=space, font="11px sans-serif", ticks={"show": False}
            )
            for size, gap, space in ((36, 4, 60.0), (46, 6, 24.0))
        )
        return self._gui.add_uplot(
            (np.array([-HISTORY_S, 0.0]), *(nothing,) * len(series)),
            (uplot.Series(label="s"), *series),
            title=title,
            scales={"x": {"time": False}, "y": scale},
            axes=axes,
            legend={"show": True, "live": False},
            cursor={"drag": {"x": False, "y": False}},
            height=118,  # three of them and the inputs fit a window of 768 pixels
            padding=(8, 10, 0, 0),
        )

    def update(self, board: Board, now_s: float) -> None:
        """Draw the newest curves."""
        self._nudge_s = 1e-6 - self._nudge_s
        limit_rad_s = board.parameter(topics.CONTROLLER, "max_joint_velocity_rad_s")
        if isinstance(limit_rad_s, float) and limit_rad_s != self._limit_rad_s:
            self._limit_rad_s = limit_rad_s  # a new scale rebuilds the chart
            scale = {"range": (0.0, 1.2 * limit_rad_s)}
            self._speed.scales = {**self._speed.scales, "y": scale}
        if board.joint_names != self._joint_names:
            self._joint_names = board.joint_names
            labels = (
                name.removesuffix("_joint").removeprefix("shoulder_").replace("_", " ")
                for name in board.joint_names
            )
            lines = (_series(*both) for both in zip(labels, cycle(markup.COLOURS), strict=False))
            self._speed.series = (uplot.Series(label="s"), *lines, _level("limit"))
        self._draw(self._error, board.error.window(now_s)[:, : len(self._error.data)])
        self._draw(self._speed, board.speed_rad_s.window(now_s), self._limit_rad_s)
        self._draw(self._ratio, board.ratio.window(now_s), 1.0)

    def _draw(self, chart: viser.GuiUplotHandle, window: np.ndarray, *levels: float) -> None:
        """Draw over the whole time span; unknown parts stay empty.

        The browser keeps the zoom relative to the span, so the span is constant. It redraws the
        axes only if the range changes, so the range changes by an invisible amount.
        """
        gaps = np.flatnonzero(np.diff(window[:, 0]) > 1.5)
        window[: gaps[-1] + 1 if len(gaps) else 0, 1:] = nan  # a line would cross the gap
        lines = [np.pad(column, 1, constant_values=nan) for column in window.T[1:]]
        times = np.concatenate(([self._nudge_s - HISTORY_S], window[:, 0], [0.0]))
        chart.data = (times, *lines, *(np.full(len(times), level) for level in levels))
