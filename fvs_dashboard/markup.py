"""The parts of the page that are plain HTML, and their texts."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from html import escape
from math import degrees, isfinite, isnan
from pathlib import Path

from fvs_controller_node.references import Reference
from fvs_controller_node.relation import OBJECT_FRAME
from fvs_dashboard.board import Board, Controller
from fvs_ros.kinds import Kind
from fvs_ros.status import SILENT

#: Okabe and Ito's colour-blind-safe palette, light enough for a dark page.
COLOURS = ("#56B4E9", "#E69F00", "#1FBF92", "#F0E442", "#E8702A", "#CC79A7")
GREY = "#8A8F98"
#: Titles of states that differ from their names; ``style.css`` has the colours.
_TITLES = {"SERVOING": "Moving", "HOLDING": "Held", SILENT: "No controller"}
#: Time without a heartbeat after which the page reports that its program has ended, s.
LOST_S = 5.0
#: Inputs of the controller, and what a person calls them.
_INPUTS = {"joint_states": "Joint states", "jacobian": "Jacobian"}
#: Services that nodes ask for, and the buttons that call them.
_BUTTONS = {
    "start": "Start",
    "stop": "Stop",
    "set_current_as_target": "Set current as target",
    "reset": "Reset",
    "teach": "Teach",
    "go_to_reference": "Go there",
}
#: Two elements after ``ROW`` are side by side; after ``TOP_ROW`` they also stay above scrolling.
ROW, TOP_ROW = '<i class="fvs-row"></i>', '<i class="fvs-row fvs-top"></i>'
#: The element after ``LIST`` has a fixed height, and scrolls.
LIST = '<i class="fvs-list"></i>'
#: Long text is clipped, so that no button moves; hovering shows all of it.
STYLE = f"<style>{Path(__file__).with_name('style.css').read_text(encoding='utf-8')}</style>"


def in_words(sentence: str) -> str:
    """A sentence of a node with the page's buttons in place of services."""
    names = "|".join(_BUTTONS)
    return re.sub(
        rf"(call )?(?:its |the estimator's )?~/({names})",
        lambda match: ("press " if match[1] else "") + _BUTTONS[match[2]],
        sentence,
    )


def distance(kind: Kind, error_m: float) -> str:
    """A distance as text in mm, two decimals below 10 mm, or in px."""
    return "–" if isnan(error_m) else kind.length_text(error_m, 2 if error_m < 0.01 else 0)


def banner_html(controller: Controller, kind: Kind) -> str:
    """The banner, readable from a distance: state, reason and error, with a fixed height.

    A refused target is shown beside its numbers instead.
    """
    title = _TITLES.get(controller.state, controller.state.capitalize())
    words = controller.sentence.replace(f" ({controller.values.get('refused_target')})", "")
    sentence, _, hint = words.partition("; ")
    if controller.reason in ("SERVOING", "SETTLED"):  # title and distance say all but remarks
        said, _, remark = words.partition(" (")
        sentence, hint = remark.removesuffix(")"), said.partition("; ")[2]
        title = "On target" if controller.reason == "SETTLED" else title
    sentence, hint = escape(in_words(sentence)), escape(in_words(hint))
    error, angle_rad = distance(kind, controller.error_m), controller.number("angle_rad")
    if isfinite(angle_rad):
        error = f"{distance(kind, controller.number('way_m'))}, {degrees(angle_rad):.2f}°"
    return (
        f'<div id="fvs-banner" data-state="{escape(controller.state)}" '
        f'title="{sentence}. {hint}"><div class="fvs-head">'
        f"<span>{escape(title)}</span>"
        f'<span id="fvs-error" class="fvs-number">{error}</span></div>'
        f'<div class="fvs-clip" style="-webkit-line-clamp:5"><span id="fvs-sentence">{sentence}'
        f'</span><div id="fvs-hint" style="opacity:0.85">{hint}</div></div></div>'
    )


def line_html(name: str, text: str) -> str:
    """A text with a fixed height of two lines, even if empty."""
    text = escape(in_words(text))
    return (
        f'<div class="fvs-small" title="{text}" style="height:2.6em">'
        f'<div id="fvs-{name}" class="fvs-clip" style="-webkit-line-clamp:2">{text}</div></div>'
    )


def reference_labels(references: Mapping[str, Reference | str]) -> dict[str, str]:
    """Names of references by what stands on their buttons: name, frame and speed."""
    labels = {}
    for name, reference in references.items():
        how = "cannot be used"
        if isinstance(reference, Reference):
            how = f"{_frame(reference)}, {100.0 * reference.speed:.0f} %"
        labels[f"{name}: {how}"] = name
    return labels


def reference_text(reference: Reference | str, kind: Kind) -> str:
    """A reference in words, or what is wrong with it."""
    if isinstance(reference, str):
        return reference
    camera = "the camera " * kind.on_arm
    return f"{camera}in the {_frame(reference)}'s frame: {kind.text(reference.z)}"


def _frame(reference: Reference) -> str:
    return "object" if reference.frame == OBJECT_FRAME else "camera"


def inputs_html(board: Board, kind: Kind, now_s: float) -> str:
    """Ages of the controller's inputs and what else it says, two per row; sentences alone."""
    controller = board.controller(now_s)
    details = {}
    parts = zip(kind.parts, kind.cameras, strict=True)
    seen = {part.feature.name: f"Seen {name}".strip() for part, name in parts}
    # Last what is seen: also where that is the object.
    labels = {**seen, **_INPUTS, kind.topics.object.name: "Object", **seen}
    for name, label in labels.items():
        age_s = controller.number(f"{name}_age_s")
        details[label] = "never" if not isfinite(age_s) else f"{1e3 * age_s:.0f} ms ago"
    if details.get("Object") == "never":  # most have none
        del details["Object"]
    running = controller.values.get("robot_program_running")
    percent = controller.number("speed_scaling_percent")
    details["Robot program"] = {"true": "runs", "false": "stopped"}.get(running or "", "unknown")
    if isfinite(percent):
        details["Robot program"] += f", {percent:.0f} %"
    for label, key in (("Image latency", "image_latency_s"), ("Drive lag", "drive_lag_s")):
        details[label] = f"{1e3 * controller.number(key):.0f} ms"
    details["Active limit"] = controller.values.get("active_limit") or "none"
    if controller.silent:
        details = {}
    if detector := board.newest("detector", now_s):
        details["Detector"] = detector
    cells = (
        f'<div class="{"fvs-wide" if name == "Detector" else ""}">'
        f'<span class="fvs-faint">{escape(name)}</span> {escape(text)}</div>'
        for name, text in details.items()
    )
    return f'<div id="fvs-inputs" class="fvs-small fvs-number">{"".join(cells)}</div>'


def alive_html(beat: int) -> str:
    """A warning that covers the banner without further heartbeats: the program has ended.

    It is a CSS animation, because only the browser still runs then. Each beat restarts it under
    another name.
    """
    return (
        '<div style="position:relative;height:0;z-index:8;pointer-events:none">'
        f'<div id="fvs-lost" style="animation-name:fvs-lost-{beat % 2};animation-delay:{LOST_S}s">'
        f"No word from this page's program for {LOST_S:g} s: what stands here is old, and Stop "
        "does nothing. Use the robot's own stop. Where the program runs again, reload the page."
        "</div></div>"
    )


def legend_html(signs: Iterable[tuple[str, tuple[int, int, int], str]]) -> str:
    """What the colours of a picture mean: a sign, its colour (RGB), and words, of each."""
    cells = [
        f'<span style="white-space:nowrap"><span style="color:rgb{colour}">{sign}</span> '
        f"{escape(words)}</span>"
        for sign, colour, words in signs
    ]
    return f'<div class="fvs-small" style="display:flex;gap:0.9em">{"".join(cells)}</div>'


def note_html(note: str) -> str:
    """A sentence about the page itself."""
    return f'<div id="fvs-note" class="fvs-small">{escape(note)}</div>'
