"""The panel of the page: what a person reads and presses."""

from __future__ import annotations

import time
from collections.abc import Callable
from math import inf

import numpy as np
import viser

from fvs_controller_node.registry import LAWS
from fvs_dashboard import markup, picture
from fvs_dashboard.actions import (
    BUMP,
    CONTROLLER,
    ESTIMATOR,
    RESET,
    SET_CURRENT,
    SIMULATOR,
    START,
    STOP,
    Action,
    point_of,
)
from fvs_dashboard.board import Board, Controller
from fvs_estimator_node.registry import ESTIMATORS

#: What somebody sets is left alone for so long, s; numbers that wait for their button, longer.
_SET_S, _TYPED_S = 4.0, 60.0
#: The page hears so often that its program lives, s.
_BEAT_S = 1.0
#: The banner keeps a state, and a sentence, for so long, s: to be read, and not to flicker.
_STEADY_S = 1.0
_METHOD, _LAW = f"{ESTIMATOR}/method", f"{CONTROLLER}/law"
_NOISE, _LATENCY = f"{SIMULATOR}/depth_noise", f"{SIMULATOR}/latency_s"
_SIGNS = (
    ("○", picture.BALL_RGB, "ball found"),
    ("+", picture.TARGET_RGB, "target"),
)


class Panel:
    """Start, Stop, banner, target, scheme, picture and the simulator's disturbances.

    What changes its height stands below all that is pressed.

    Parameters
    ----------
    gui : viser.GuiApi
        Where it is put.
    say : callable
        Takes what a person does; called in the page's threads.
    image : bool
        Whether there will be a picture.
    tour : bool
        Whether a tour can be had.
    """

    def __init__(
        self, gui: viser.GuiApi, say: Callable[[Action], None], image: bool, tour: bool
    ) -> None:
        self._gui = gui
        self._say = say
        self._held_until_s: dict[str, float] = {}
        gui.add_html(markup.side_by_side("start-stop", always=True))
        self._button("Start", START, color="teal", icon=viser.Icon.PLAYER_PLAY)
        self._button("Stop", STOP, color="red", icon=viser.Icon.PLAYER_STOP)
        self._alive = gui.add_html("")
        self._beat_s, self._beats = -inf, 0
        self._banner = gui.add_html("")
        self._shown = markup.banner_of(Controller({}, ""))
        self._state_s = self._sentence_s = -inf  # when they changed
        self._answer = gui.add_html("")
        self._add_target(tour)
        self._scheme = gui.add_folder("Scheme")
        with self._scheme:
            self._settings: dict[str, viser.GuiInputHandle] = {
                _METHOD: gui.add_dropdown("Estimator", tuple(ESTIMATORS)),
                _LAW: gui.add_dropdown("Law", tuple(LAWS)),
            }
        self._beside = gui.add_html(markup.side_by_side("reset-bump"))
        self._button(
            "Reset everything",
            RESET,
            color="gray",
            hint="Stops, forgets what was learned, and puts the simulation back as it began.",
        )
        self._bump = self._button(
            "Bump the camera", BUMP, color="gray", hint="Turns the simulated camera by chance."
        )
        self._beside.visible = self._bump.visible = False  # until a simulator is heard of
        self._picture: viser.GuiImageHandle | None = None
        if image:
            self._picture = gui.add_image(picture.BLANK, format="jpeg", jpeg_quality=75)
            gui.add_html(markup.legend_html(_SIGNS))
        self._simulator = gui.add_folder(
            "Simulator: disturb it", visible=False, expand_by_default=False
        )
        with self._simulator:
            self._settings[_NOISE] = gui.add_slider(
                "Depth noise (×)", 0.0, 5.0, 0.1, 1.0, hint="Times the depth camera's own noise."
            )
            self._settings[_LATENCY] = gui.add_slider("Latency (s)", 0.0, 0.2, 0.005, 0.04)
        for name, handle in self._settings.items():
            self._sets(handle, name)

    # --- what is there ---

    def _button(self, label: str, action: Action, **look: str) -> viser.GuiButtonHandle:
        button = self._gui.add_button(label, **look)

        @button.on_click
        async def _(_event: viser.GuiEvent) -> None:
            if action in (SET_CURRENT, RESET):
                self.forget_typed()
            self._say(action)

        return button

    def _add_target(self, tour: bool) -> None:
        gui = self._gui
        with gui.add_folder("Target in the camera's frame"):
            self._target = gui.add_text("x, y, z (m)", "")
            gui.add_html(markup.side_by_side("go-current"))
            go = gui.add_button("Go", color="blue", icon=viser.Icon.TARGET_ARROW)
            self._button("Set current as target", SET_CURRENT, color="gray")
            self._refusal = gui.add_html("")
            self._typed_wrong = ""
            self._tour = gui.add_checkbox(
                "Tour", False, visible=tour, hint="Send it to one after another."
            )

        @self._target.on_update
        async def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                self._hold("target", _TYPED_S)

        @go.on_click
        async def _(_event: viser.GuiEvent) -> None:
            try:
                wanted = Action("target", point_of(self._target.value))
            except ValueError as error:
                self._typed_wrong = str(error)
                return
            self._typed_wrong = ""
            self._hold("target")  # until the controller has taken it
            self._say(wanted)

        @self._tour.on_update
        async def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                self._hold("tour")
                self._say(Action("tour", self._tour.value))

    def _sets(self, handle: viser.GuiInputHandle, name: str) -> None:
        @handle.on_update
        async def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                self._hold(name)
                self._say(Action(name, handle.value))

    # --- what is shown ---

    def update(self, board: Board, now_s: float, new_picture: np.ndarray | None) -> None:
        """Show a moment."""
        if now_s - self._beat_s > _BEAT_S:
            self._beat_s, self._beats = now_s, self._beats + 1
            self._alive.content = markup.alive_html(self._beats)
        controller = board.controller(now_s)
        self._show_banner(markup.banner_of(controller), controller.error_m, now_s)
        self._answer.content = markup.line_html("answer", board.answered(now_s), 2)
        refusal = self._typed_wrong or controller.values.get("refused_target", "")
        self._refusal.content = markup.line_html("refusal", refusal, 2)
        if self._picture is not None and new_picture is not None:
            self._picture.image = new_picture
        if self._free("tour"):
            self._tour.value = board.tour
        if controller.target_m is not None and self._free("target"):
            self._target.value = ", ".join(f"{value:.3f}" for value in controller.target_m)
        self._scheme.label = f"Scheme: {markup.scheme_of(board)}"
        simulated = bool(board.parameters.get(SIMULATOR))
        self._simulator.visible = self._bump.visible = self._beside.visible = simulated
        for name, handle in self._settings.items():
            node, _, parameter = name.partition("/")
            value = board.parameter(node, parameter)
            if isinstance(value, type(handle.value)) and self._free(name):
                handle.value = value

    def _show_banner(self, banner: markup.Banner, error_m: float, now_s: float) -> None:
        """Show title and distance as they are; state and sentence stay for a while."""
        same = banner.state == self._shown.state
        if now_s - (self._sentence_s if same else self._state_s) > _STEADY_S:
            self._state_s = self._state_s if same else now_s
            self._shown, self._sentence_s = banner, now_s
        elif same:
            self._shown = self._shown._replace(title=banner.title)
        self._banner.content = markup.banner_html(self._shown, error_m)

    def _hold(self, name: str, seconds: float = _SET_S) -> None:
        """Leave to the person what they are setting."""
        self._held_until_s[name] = time.monotonic() + seconds

    def forget_typed(self) -> None:
        """Show the controller's target again, whatever somebody typed and did not send."""
        self._typed_wrong = ""
        self._held_until_s.pop("target", None)

    def _free(self, name: str) -> bool:
        """Whether nobody is just setting it."""
        return time.monotonic() > self._held_until_s.get(name, -inf)
