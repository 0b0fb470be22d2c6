"""The parts of the page that are plain HTML, and their texts."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from html import escape
from math import degrees, isfinite, isnan, nan
from pathlib import Path

from fvs_controller_node.references import Reference
from fvs_controller_node.relation import OBJECT_FRAME
from fvs_dashboard.board import Board, way_m
from fvs_ros.kinds import Kind
from fvs_ros.status import SILENT

#: Okabe and Ito's colour-blind-safe palette, light enough for a dark page.
COLOURS = ("#56B4E9", "#E69F00", "#1FBF92", "#F0E442", "#E8702A", "#CC79A7")
GREY = "#8A8F98"
#: Titles of states that differ from their names; ``style.css`` has the colours.
_TITLES = {"SERVOING": "Moving", "HOLDING": "Held", SILENT: "No controller"}
#: Time without a heartbeat after which the page reports that its program has ended, s.
LOST_S = 5.0
_UNKNOWN = "not drawn: the camera's pose is unknown; calibrate (fvs_launch calibrate)"
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


def distance(kind: Kind, errors: Mapping[str, float]) -> str:
    """A distance, and of what turns an angle, as text; never finer than a tenth."""
    far_m, angle_rad = way_m(errors), errors.get("angle_rad", nan)
    if isnan(far_m):
        return "–"
    texts = [kind.length_text(far_m, int(far_m < 0.01))]
    if isfinite(angle_rad):
        texts.append(f"{degrees(angle_rad):.1f}°")
    return ", ".join(re.sub(r"^0\.0\b", "&lt; 0.1", text) for text in texts)


def banner_html(board: Board, kind: Kind, now_s: float) -> str:
    """The banner, readable from a distance: state, error, reason, and the answer to an action.

    It is as high as its text, over the picture below it, so that no button moves.
    """
    controller, true = board.controller(now_s), distance(kind, board.true_errors(now_s))
    title = _TITLES.get(controller.state, controller.state.capitalize())
    sentence, _, hint = controller.sentence.partition("; ")
    if controller.reason in ("SERVOING", "SETTLED"):  # title and distance say all but remarks
        said, _, remark = controller.sentence.partition(" (")
        sentence, hint = remark.removesuffix(")"), said.partition("; ")[2]
        title = "On target" if controller.reason == "SETTLED" else title
    lines = {"sentence": sentence, "hint": hint, "answer": board.newest("answer", now_s) or ""}
    text = "".join(
        f'<div id="fvs-{name}">{escape(in_words(words))}</div>' for name, words in lines.items()
    )
    error = distance(kind, controller.errors(kind))
    known = "; ".join(["estimated"] * (error != "–") + [f"true {true}"] * (true != "–"))
    return (
        f'<div class="fvs-over{" fvs-alone" * (not kind.rigid)}">'
        f'<div id="fvs-banner" data-state="{escape(controller.state)}"><div class="fvs-head">'
        f'<span>{escape(title)}</span><span id="fvs-error" class="fvs-number">'
        f'{error}</span></div><div id="fvs-true" class="fvs-number">{known}</div>{text}</div></div>'
    )


def line_html(name: str, text: str) -> str:
    """A text with a fixed height of two lines, even if empty."""
    text = escape(in_words(text))
    return (
        f'<div class="fvs-small" title="{text}" style="height:2.6em">'
        f'<div id="fvs-{name}" class="fvs-clip">{text}</div></div>'
    )


def caption_html(text: str) -> str:
    """A text over the lower edge of the picture before it."""
    return f'<div class="fvs-caption"><div id="fvs-picture">{escape(text)}</div></div>'


def meanings(known: Mapping[str, type]) -> str:
    """What the names in a registry stand for, a line each."""
    firsts = {name: (each.__doc__ or "").partition("\n")[0] for name, each in known.items()}
    return "\n".join(f"{name}: {first}" for name, first in firsts.items()).replace("``", "")


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
    what = kind.what.capitalize()
    seen = {part.feature.name: f"{what} {name}".strip() for part, name in parts}
    # Last what is seen: also where that is the object.
    labels = {**seen, **_INPUTS, kind.topics.object.name: "Object", **seen}
    for name, label in labels.items():
        age_s = controller.number(f"{name}_age_s")
        details[label] = "never" if not isfinite(age_s) else f"{1e3 * age_s:.0f} ms ago"
    if details.get("Object") == "never":  # most have none
        del details["Object"]
    running = controller.values.get("robot_program_running")
    percent = controller.number("speed_scaling_percent")
    details["Program"] = {"true": "runs", "false": "stopped"}.get(running or "", "unknown")
    if isfinite(percent):
        details["Program"] += f", {percent:.0f} %"
    for label, key in (("Image latency", "image_latency_s"), ("Drive lag", "drive_lag_s")):
        details[label] = f"{1e3 * controller.number(key):.0f} ms"
    if controller.silent:
        details = {}
    arm = _UNKNOWN if board.camera is None else board.newest("arm", now_s)
    limit = controller.values.get("active_limit") or "none" * bool(details)
    wide = {"Active limit": limit, "Detector": board.newest("detector", now_s)}
    wide |= {"Arm": arm} if kind.rigid else {}
    details |= {name: words for name, words in wide.items() if words}
    cells = (
        f'<div class="{"fvs-wide" if name in wide else ""}">'
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
        '<div class="fvs-over" style="height:0;z-index:9;pointer-events:none">'
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
    return f'<div class="fvs-small fvs-legend">{"".join(cells)}</div>'
