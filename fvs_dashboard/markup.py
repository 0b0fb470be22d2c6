"""The parts of the page that are plain HTML: banner, inputs, answers."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from math import isfinite, isnan
from typing import NamedTuple

from fvs_dashboard.actions import CONTROLLER, ESTIMATOR
from fvs_dashboard.board import Board, Controller
from fvs_ros.status import SILENT
from fvs_tools.schemes import BEYOND, SCHEMES

#: Okabe and Ito's colours, which everybody can tell apart, light enough for a dark page.
SKY, ORANGE, GREEN, YELLOW, VERMILLION, PINK, GREY = (
    "#56B4E9",
    "#E69F00",
    "#1FBF92",
    "#F0E442",
    "#E8702A",
    "#CC79A7",
    "#8A8F98",
)
#: What each state is called, and its colour behind white letters.
_TITLES = {
    "SERVOING": ("Moving to target", "#009E73"),
    "READY": ("Ready", "#0072B2"),
    "WAITING": ("Waiting", "#6B7280"),
    "HOLDING": ("Held", "#B87A00"),
    "FAULT": ("Fault", "#D55E00"),
    SILENT: ("No controller", "#6B7280"),
}
#: Without a sign of life for so long, a page says that its program has ended, s.
LOST_S = 5.0
#: A lamp says how it is by its sign, too, not by its colour alone.
_LAMPS = {True: (GREEN, "✓"), False: (VERMILLION, "✗"), None: (GREY, "?")}
#: Inputs of the controller, what a person calls them, and the limits of their ages.
_INPUTS = {
    "ball_position": ("Ball seen", "ball_max_age_s"),
    "joint_states": ("Joint states", "joint_states_max_age_s"),
    "jacobian": ("Jacobian", "jacobian_max_age_s"),
}
#: Parameters of the controller that the page shows something by: limits, and what a scheme is.
SHOWN_BY = (
    "law",
    "max_joint_velocity_rad_s",
    *(limit for _, limit in _INPUTS.values()),
    *sorted({name for one in BEYOND.values() for name in one.controller_values}),
)
#: What the controller asks for by a service's name stands on the page as a button.
_BUTTONS = {
    "publish one, or call ~/set_current_as_target": "set one, or press Set current as target",
    "call its ~/stop": "press Stop",
    "call ~/stop": "press Stop",
    "call ~/start": "press Start",
    "then ~/start": "then Start",
    "call the estimator's ~/reset": "press Reset everything",
    "the estimator's ~/reset": "Reset everything",
    "call ~/reset": "press Reset everything",
}
#: What fits one place keeps its height, whatever it says; all of it is told to who points there.
_CLIPPED = "overflow:hidden;display:-webkit-box;-webkit-box-orient:vertical;-webkit-line-clamp:"
_GRID = (
    "margin:0 0.75em 0.4em 0.75em;font-size:0.8em;display:grid;grid-template-columns:1fr 1fr;"
    "line-height:1.2;gap:0.4em 0.75em"
)


def side_by_side(name: str, always: bool = False) -> str:
    """Put the next two elements of the panel into one row; ``name`` is unique.

    With ``always`` they are large, and stay on top while what is below is scrolled.
    """
    mark = f"div:has(> #fvs-{name})"
    first, second = f"{mark} + div", f"{mark} + div + div"
    style = (
        f"{first}, {second} {{display:inline-block;box-sizing:border-box;vertical-align:top;"
        "width:calc(50% - 14px);padding-inline:0 !important;margin-inline:10px 4px !important} "
        f"{second} {{margin-inline:4px 10px !important}} "
        f"{first} button, {second} button {{padding-inline:4px}} "
    )
    if always:
        style += (
            # What is scrolled under them is not to be seen between them.
            f"{first}, {second} {{position:sticky;top:10px;z-index:9;"
            "background:var(--mantine-color-body);"
            "box-shadow:0 -4px 0 4px var(--mantine-color-body),"
            "0 -8px 0 4px var(--mantine-color-body)}} "
            f"{first} button, {second} button {{height:38px;font-size:16px;font-weight:650}} "
            # What clips the panel would hold them.
            f"div:has(> div > div > div > #fvs-{name}) {{overflow:visible !important}}"
        )
    return f'<div id="fvs-{name}"></div><style>{style}</style>'


def in_words(sentence: str) -> str:
    """A sentence of a node in the page's own words."""
    for service, button in _BUTTONS.items():
        sentence = sentence.replace(service, button)
    return sentence


class Banner(NamedTuple):
    """What is to be read from afar: title, its colour, sentence, hint."""

    state: str
    title: str
    colour: str
    sentence: str
    hint: str


def banner_of(controller: Controller) -> Banner:
    """The banner of a controller: each thing once, a refused target elsewhere."""
    title, colour = _TITLES.get(controller.state, (controller.state.capitalize(), "#6B7280"))
    if controller.reason == "SETTLED":
        title = "On target"
    refused = controller.values.get("refused_target") or "\0"
    words = controller.sentence.replace(f" ({refused})", "").replace(f"({refused}; ", "(")
    sentence, _, hint = words.partition("; ")
    if controller.reason in ("SERVOING", "SETTLED"):  # title and distance say it already
        sentence, hint = words.partition(" (")[2].removesuffix(")"), ""
    elif controller.reason == "READY":
        sentence = ""
    return Banner(controller.state, title, colour, in_words(sentence), in_words(hint))


def distance(error_m: float) -> str:
    """A distance as text in mm, two figures below 10 mm."""
    if isnan(error_m):
        return "–"
    error_mm = 1e3 * error_m
    return f"{error_mm:.2f} mm" if error_mm < 10.0 else f"{error_mm:.0f} mm"


def banner_html(banner: Banner, error_m: float) -> str:
    """The banner, of one height whatever it says, and the distance to go."""
    said = f"{banner.sentence}. {banner.hint}"
    return (
        f'<div id="fvs-banner" data-state="{escape(banner.state)}" title="{escape(said)}" '
        f'style="margin:0 0.75em 0.4em 0.75em;border-radius:6px;background:{banner.colour};'
        'color:#fff;padding:0.4em 0.8em;box-sizing:border-box;height:9.3em;overflow:hidden">'
        '<div style="display:flex;justify-content:space-between;align-items:baseline;gap:0.5em">'
        '<span style="flex:1 1 0;width:0;overflow:hidden;text-overflow:ellipsis;white-space:nowrap;'
        f'font-size:1.3em;font-weight:650">{escape(banner.title)}'
        '</span><span id="fvs-error" style="font-size:1.4em;font-weight:650;white-space:nowrap;'
        f'font-variant-numeric:tabular-nums">{distance(error_m)}</span></div>'
        f'<div style="line-height:1.3;{_CLIPPED}5">'
        f'<span id="fvs-sentence">{escape(banner.sentence)}</span>'
        f'<div id="fvs-hint" style="opacity:0.85">{escape(banner.hint)}</div></div></div>'
    )


def line_html(name: str, text: str, lines: int) -> str:
    """A text that keeps its place of so many lines where there is nothing to say."""
    text = escape(in_words(text))
    return (
        f'<div title="{text}" style="margin:0 0.9em;font-size:0.85em;line-height:1.3;'
        f'height:{1.3 * lines:g}em;overflow:hidden">'
        f'<div id="fvs-{name}" style="{_CLIPPED}{lines}">{text}</div></div>'
    )


def scheme_of(board: Board) -> str:
    """The name of the scheme that runs; of a pair without a name, the pair."""
    method, law = board.parameter(ESTIMATOR, "method"), board.parameter(CONTROLLER, "law")
    for one in (*SCHEMES.values(), *BEYOND.values()):
        further = one.controller_values.items()
        if (one.method, one.law) == (method, law) and all(
            board.parameter(CONTROLLER, name) == value for name, value in further
        ):
            return one.name
    return " with ".join(name for name in (method, law) if isinstance(name, str)) or "unknown"


class Lamp(NamedTuple):
    """One thing that is well or not (None while unknown), and how it is."""

    name: str
    good: bool | None
    text: str


def lamps_of(board: Board, now_s: float) -> list[Lamp]:
    """The lamps: the controller's inputs and the robot's program."""
    controller = board.controller(now_s)
    lamps = []
    for name, (label, limit) in _INPUTS.items():
        age_s = controller.number(f"{name}_age_s")
        if not isfinite(age_s):
            age_s = board.age_s(name, now_s)
        if isfinite(age_s):
            text = f"{1e3 * age_s:.0f} ms ago" if age_s < 1.0 else f"{age_s:.0f} s ago"
        else:
            text = "unknown" if controller.silent else "never"
        limit_s = board.limit(limit)
        known = isfinite(limit_s) and not controller.silent
        lamps.append(Lamp(label, age_s <= limit_s if known else None, text))
    percent = controller.number("speed_scaling_percent")
    running = controller.values.get("robot_program_running")
    if controller.silent or running == "unknown":
        lamps.append(Lamp("Robot program", None, "unknown"))
    elif running != "true":
        lamps.append(Lamp("Robot program", False, "stopped"))
    else:
        text = "runs" if isnan(percent) else f"runs, {percent:.0f} %"
        lamps.append(Lamp("Robot program", percent != 0.0, text))
    return lamps


def details_of(board: Board, now_s: float) -> dict[str, str]:
    """What the troubleshooting asks for, by name; what is unknown is left out."""
    controller = board.controller(now_s)
    details = {
        name: f"{1e3 * controller.number(key):.0f} ms"
        for name, key in (("Image latency", "image_latency_s"), ("Drive lag", "drive_lag_s"))
        if isfinite(controller.number(key))
    }
    if not controller.silent:  # stands there while there is none, too: it comes and goes often
        details["Active limit"] = controller.values.get("active_limit") or "none"
    if detector := board.detector(now_s):
        details["Detector"] = detector
    return details


def inputs_html(lamps: Iterable[Lamp], details: dict[str, str]) -> str:
    """What is well and what is not, two a row, and the details below."""
    cells = []
    for lamp in lamps:
        colour, sign = _LAMPS[lamp.good]
        cells.append(
            '<div style="display:flex;align-items:center;gap:0.5em;min-width:0">'
            f'<span style="width:1.35em;height:1.35em;line-height:1.35em;text-align:center;'
            f"border-radius:50%;background:{colour};color:#101214;font-weight:700;"
            f'flex-shrink:0">{sign}</span><span style="min-width:0">{escape(lamp.name)} '
            '<span style="opacity:0.65;font-variant-numeric:tabular-nums">'
            f"{escape(lamp.text)}</span></span></div>"
        )
    for name, text in details.items():
        wide = "" if name.endswith(("latency", "lag")) else "grid-column:1 / -1;"
        cells.append(
            f'<div style="{wide}min-width:0;font-variant-numeric:tabular-nums">'
            f'<span style="opacity:0.65">{escape(name)}</span> {escape(text)}</div>'
        )
    return f'<div id="fvs-inputs" style="{_GRID}">{"".join(cells)}</div>'


def alive_html(beat: int) -> str:
    """A warning that covers the banner where no further beat comes: the program has ended.

    A page without its program shows what it was told last, and for ever; nobody is left to change
    it but the browser itself.
    """
    name = f"fvs-lost-{beat % 2}"  # another one: or the browser might go on with the old wait
    return (
        f"<style>@keyframes {name} {{from {{opacity:0}} to {{opacity:1}}}}</style>"
        '<div style="position:relative;height:0;z-index:8;pointer-events:none">'
        '<div id="fvs-lost" style="position:absolute;left:0.75em;right:0.75em;height:9.3em;'
        f"box-sizing:border-box;opacity:0;animation:{name} 0.1s linear {LOST_S:g}s forwards;"
        f"padding:0.5em 0.8em;border-radius:6px;background:{VERMILLION};color:#101214;"
        'font-weight:650;line-height:1.3">'
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
    return (
        '<div style="margin:0 0.75em;font-size:0.75em;line-height:1.3;display:flex;gap:0.9em">'
        f"{''.join(cells)}</div>"
    )


def notes_html(notes: Iterable[str]) -> str:
    """Sentences about the page itself."""
    lines = "".join(f"<div>{escape(in_words(note))}</div>" for note in notes)
    return (
        f'<div id="fvs-notes" style="margin:0 0.75em;font-size:0.8em;line-height:1.3;opacity:0.8">'
        f"{lines}</div>"
    )
