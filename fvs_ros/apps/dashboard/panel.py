"""The panel of the page: what a person reads and presses."""

from __future__ import annotations

import time
from collections.abc import Callable
from math import inf

import numpy as np
import viser

from fvs_ros.apps.dashboard import markup, picture
from fvs_ros.apps.dashboard.actions import (
    SET_CURRENT,
    START,
    STOP,
    Action,
    Disturb,
    PutBack,
    Remark,
    Target,
    Tour,
    as_point,
    point_of,
)
from fvs_ros.apps.dashboard.scene import LEGEND
from fvs_ros.apps.dashboard.view import Snapshot

#: What somebody sets is left alone for so long, s; numbers that wait for their button, longer.
_SET_S, _TYPED_S = 4.0, 60.0
#: The page hears so often that its program lives, s.
_BEAT_S = 1.0
_ROTATION = "camera_rotation_deg"
_LARGEST_TURN_DEG = 45.0


class Panel:
    """Banner, lamps, buttons, target, picture and the simulator's disturbances.

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
        # On top of all that grows and shrinks: a Stop must be where it was a moment ago.
        gui.add_html(markup.side_by_side("start-stop", always=True))
        self._add_buttons()
        self._alive = gui.add_html("")
        self._beat_s, self._beats = -inf, 0
        self._banner = gui.add_html("")
        self._answer = gui.add_html("")
        self._lamps = gui.add_html("")
        self._details = gui.add_html("")
        self._add_target(tour)
        self._picture: viser.GuiImageHandle | None = None
        if image:
            blank = np.full((240, 320, 3), 32, np.uint8)
            self._picture = gui.add_image(blank, format="jpeg", jpeg_quality=75)
            gui.add_html(markup.legend_html("Picture", picture.LEGEND))
        gui.add_html(markup.legend_html("View", LEGEND))
        self._notes = gui.add_html("")
        self._add_simulator()

    # --- what is there ---

    def _add_buttons(self) -> None:
        gui = self._gui
        icons = viser.Icon
        self._button(gui.add_button("Start", color="teal", icon=icons.PLAYER_PLAY), START)
        self._button(gui.add_button("Stop", color="red", icon=icons.PLAYER_STOP), STOP)

    def _button(self, button: viser.GuiButtonHandle, action: Action) -> None:
        @button.on_click
        async def _(_event: viser.GuiEvent) -> None:
            self._say(action)

    def _add_target(self, tour: bool) -> None:
        gui = self._gui
        with gui.add_folder("Target in the camera's frame"):
            self._target = gui.add_text("x, y, z (m)", "")
            gui.add_html(markup.side_by_side("go-current"))
            go = gui.add_button("Go", color="blue", icon=viser.Icon.TARGET_ARROW)
            current = gui.add_button("Set current as target", color="gray")
            self._tour = gui.add_checkbox(
                "Tour", False, visible=tour, hint="Send it to one after another."
            )

        @current.on_click
        async def _(_event: viser.GuiEvent) -> None:
            self.forget_typed()
            self._say(SET_CURRENT)

        @self._target.on_update
        async def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                self._hold("target", _TYPED_S)

        @go.on_click
        async def _(_event: viser.GuiEvent) -> None:
            try:
                wanted: Action = Target(point_of(self._target.value))
            except ValueError as error:
                self._say(Remark(str(error)))
                return
            self._hold("target")  # until the controller has taken it
            self._say(wanted)

        @self._tour.on_update
        async def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                self._hold("tour")
                self._say(Tour(self._tour.value))

    def _add_simulator(self) -> None:
        gui = self._gui
        self._simulator = gui.add_folder(
            "Simulator: disturb it, turn its camera", visible=False, expand_by_default=False
        )
        with self._simulator:
            self._noise = gui.add_slider(
                "Depth noise (×)", 0.0, 5.0, 0.1, 1.0, hint="Times the depth camera's own noise."
            )
            self._latency = gui.add_slider("Latency (ms)", 0.0, 200.0, 5.0, 40.0)
            self._turns = tuple(
                gui.add_slider(f"Turn {axis} (°)", -_LARGEST_TURN_DEG, _LARGEST_TURN_DEG, 1.0, 0.0)
                for axis in "xyz"
            )
            back = gui.add_button(
                "Put the arm back",
                color="gray",
                hint="Where it began, at once: when it hides the ball, say.",
            )
        self._button(back, PutBack())
        self._disturb(self._noise, "depth_noise", lambda: self._noise.value)
        self._disturb(self._latency, "latency_s", lambda: 1e-3 * self._latency.value)
        for turn in self._turns:
            self._disturb(turn, _ROTATION, lambda: tuple(one.value for one in self._turns))

    def _disturb(
        self, slider: viser.GuiSliderHandle, name: str, value: Callable[[], float | tuple]
    ) -> None:
        @slider.on_update
        async def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                self._hold(name)
                self._say(Disturb(name, value()))

    # --- what is shown ---

    def update(self, shown: Snapshot) -> None:
        """Show a moment."""
        if time.monotonic() - self._beat_s > _BEAT_S:
            self._beat_s, self._beats = time.monotonic(), self._beats + 1
            self._alive.content = markup.alive_html(self._beats)
        self._banner.content = markup.banner_html(shown.banner)
        self._lamps.content = markup.lamps_html(shown.lamps)
        self._details.content = markup.details_html(shown.details)
        self._answer.content = markup.answer_html(shown.answer)
        self._notes.content = markup.notes_html(shown.notes)
        if self._picture is not None and shown.picture is not None:
            self._picture.image = picture.with_age(shown.picture, shown.picture_old_s)
        if self._free("tour"):
            self._tour.value = shown.tour
        if shown.controller.target_m is not None and self._free("target"):
            target = as_point(shown.controller.target_m)
            self._target.value = ", ".join(f"{value:.3f}" for value in target)
        self._show_simulator(shown)

    def _show_simulator(self, shown: Snapshot) -> None:
        self._simulator.visible = shown.simulator is not None
        values = shown.simulator or {}
        if "depth_noise" in values and self._free("depth_noise"):
            self._noise.value = values["depth_noise"]
        if "latency_s" in values and self._free("latency_s"):
            self._latency.value = 1e3 * values["latency_s"]
        if _ROTATION in values and self._free(_ROTATION):
            for slider, angle in zip(self._turns, values[_ROTATION], strict=True):
                slider.value = angle

    def _hold(self, name: str, seconds: float = _SET_S) -> None:
        """Leave to the person what they are setting."""
        self._held_until_s[name] = time.monotonic() + seconds

    def forget_typed(self) -> None:
        """Show the controller's target again, whatever somebody typed and did not send."""
        self._held_until_s.pop("target", None)

    def _free(self, name: str) -> bool:
        """Whether nobody is just setting it."""
        return time.monotonic() > self._held_until_s.get(name, -inf)
