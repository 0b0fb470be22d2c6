"""The panel of the page: what a person reads and presses."""

from __future__ import annotations

import time
from collections.abc import Callable
from math import inf

import numpy as np
import viser

from fvs_controller_node.config import LAWS
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
)
from fvs_dashboard.board import Board, Controller
from fvs_estimator_node.registry import ESTIMATORS

#: What a person sets is left alone for this long, s; numbers that wait for their button, longer.
_SET_S, _TYPED_S = 4.0, 60.0
#: The browser gets a sign of life this often, s.
_BEAT_S = 1.0
#: The banner keeps what it says for at least this long, s: to be read, and not to flicker.
_STEADY_S = 1.0
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
    tour : bool
        Whether a tour can be had.
    """

    def __init__(self, gui: viser.GuiApi, say: Callable[[Action], None], tour: bool) -> None:
        self._gui = gui
        self._say = say
        self._held_until_s: dict[str, float] = {}
        gui.add_html(markup.STYLE + markup.TOP_ROW)
        self._button("Start", START, color="teal", icon=viser.Icon.PLAYER_PLAY)
        self._button("Stop", STOP, color="red", icon=viser.Icon.PLAYER_STOP)
        self._alive = gui.add_html("")
        self._beat_s, self._beats = -inf, 0
        self._banner = gui.add_html("")
        self._shown = markup.banner_of(Controller({}, ""))
        self._shown_s = -inf  # when it changed
        self._answer = gui.add_html("")
        self._add_target(tour)
        self._scheme = gui.add_folder("Scheme")
        with self._scheme:
            self._sets(f"{ESTIMATOR}/method", gui.add_dropdown("Estimator", tuple(ESTIMATORS)))
            self._sets(f"{CONTROLLER}/law", gui.add_dropdown("Law", tuple(LAWS)))
        row = gui.add_html(markup.ROW)
        self._button(
            "Reset everything",
            RESET,
            color="gray",
            hint="Stops, forgets what was learned, and puts the simulation back as it began.",
        )
        bump = self._button(
            "Bump the camera", BUMP, color="gray", hint="Turns the simulated camera by chance."
        )
        self._picture = gui.add_image(picture.BLANK, format="jpeg", jpeg_quality=75)
        gui.add_html(markup.legend_html(_SIGNS))
        simulator = gui.add_folder("Simulator: disturb it", expand_by_default=False)
        with simulator:
            hint = "Times the depth camera's own noise."
            noise = gui.add_slider("Depth noise (×)", 0.0, 5.0, 0.1, 1.0, hint=hint)
            self._sets(f"{SIMULATOR}/depth_noise", noise)
            latency = gui.add_slider("Latency (s)", 0.0, 0.2, 0.005, 0.04)
            self._sets(f"{SIMULATOR}/latency_s", latency)
        self._simulated = (row, bump, simulator)  # shown beside a simulator only
        for element in self._simulated:
            element.visible = False

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
            self._target = gui.add_vector3("x, y, z (m)", (0.0, 0.0, 0.0), step=0.001)
            gui.add_html(markup.ROW)
            go = gui.add_button("Go", color="blue", icon=viser.Icon.TARGET_ARROW)
            self._button("Set current as target", SET_CURRENT, color="gray")
            self._refusal = gui.add_html("")
            hint = "Send it to one after another."
            self._tour = gui.add_checkbox("Tour", False, visible=tour, hint=hint)
        self._settings: dict[str, viser.GuiInputHandle] = {}
        self._sets("tour", self._tour)

        @self._target.on_update
        async def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                self._hold("target", _TYPED_S)

        @go.on_click
        async def _(_event: viser.GuiEvent) -> None:
            x, y, z = (float(value) for value in self._target.value)
            self._hold("target", _SET_S)  # until the controller has taken it
            self._say(Action("target", (x, y, z)))

    def _sets(self, name: str, handle: viser.GuiInputHandle) -> None:
        """Say what a person sets, and show it as it is otherwise."""
        self._settings[name] = handle

        @handle.on_update
        async def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                self._hold(name, _SET_S)
                self._say(Action(name, handle.value))

    # --- what is shown ---

    def update(self, board: Board, now_s: float, new_picture: np.ndarray | None) -> None:
        """Show a moment."""
        if now_s - self._beat_s > _BEAT_S:
            self._beat_s, self._beats = now_s, self._beats + 1
            self._alive.content = markup.alive_html(self._beats)
        controller = board.controller(now_s)
        banner = markup.banner_of(controller)
        if banner != self._shown and now_s - self._shown_s > _STEADY_S:
            self._shown, self._shown_s = banner, now_s
        self._banner.content = markup.banner_html(self._shown, controller.error_m)
        self._answer.content = markup.line_html("answer", board.newest("answer", now_s) or "")
        refusal = controller.values.get("refused_target", "")
        self._refusal.content = markup.line_html("refusal", refusal)
        if new_picture is not None:
            self._picture.image = new_picture
        if controller.target_m is not None and self._free("target"):
            self._target.value = tuple(np.round(controller.target_m, 3).tolist())
        self._scheme.label = f"Scheme: {markup.scheme_of(board)}"
        for element in self._simulated:
            element.visible = bool(board.parameters.get(SIMULATOR))
        for name, handle in self._settings.items():
            value = board.tour if name == "tour" else board.parameter(*name.split("/"))
            if isinstance(value, type(handle.value)) and self._free(name):
                handle.value = value

    def forget_typed(self) -> None:
        """Show the controller's target again, whatever was typed and not sent."""
        self._held_until_s.pop("target", None)

    def _hold(self, name: str, seconds: float) -> None:
        """Leave to the person what they are setting."""
        self._held_until_s[name] = time.monotonic() + seconds

    def _free(self, name: str) -> bool:
        """Whether no person is just setting it."""
        return time.monotonic() > self._held_until_s.get(name, -inf)
