"""The parts of the page that are plain HTML: banner, lamps, answers."""

from __future__ import annotations

from html import escape

from fvs_ros.apps.dashboard.view import Banner, Lamp

#: Okabe and Ito's colours, which everybody can tell apart, light enough for a dark page.
SKY, ORANGE, GREEN, YELLOW, BLUE, VERMILLION, PINK, GREY = (
    "#56B4E9",
    "#E69F00",
    "#1FBF92",
    "#F0E442",
    "#3E9BDC",
    "#E8702A",
    "#CC79A7",
    "#8A8F98",
)

#: A lamp says how it is by its sign, too, not by its colour alone.
_LAMPS = {True: (GREEN, "✓"), False: (VERMILLION, "✗"), None: (GREY, "?")}

_BOX = "margin:0 0.75em 0.5em 0.75em;border-radius:6px;"


#: What the controller asks for by a service's name stands on the page as a button.
_BUTTONS = {
    "call ~/start": "press Start",
    "publish one, or call ~/set_current_as_target": "set one, or press Set current as target",
}


def side_by_side(name: str) -> str:
    """Put the next two elements of the panel into one row; ``name`` is unique."""
    mark = f"div:has(> #fvs-{name})"
    return (
        f'<div id="fvs-{name}"></div><style>{mark} + div, {mark} + div + div '
        "{display:inline-block;width:50%;box-sizing:border-box;vertical-align:top;"
        "margin-inline:0 !important;padding-inline:0.4em !important}</style>"
    )


def _in_words(sentence: str) -> str:
    """A sentence of the controller as markup, in the page's own words."""
    for service, button in _BUTTONS.items():
        sentence = sentence.replace(service, button)
    return escape(sentence)


def banner_html(banner: Banner) -> str:
    """The state, large, with the distance to go and the controller's sentence."""
    return (
        f'<div style="{_BOX}background:{banner.colour};color:#fff;padding:0.7em 0.9em;">'
        '<div style="display:flex;justify-content:space-between;align-items:baseline;gap:0.6em">'
        f'<span style="font-size:1.3em;font-weight:650">{escape(banner.title)}</span>'
        '<span id="fvs-error" style="font-size:1.5em;font-weight:650;white-space:nowrap;'
        f'font-variant-numeric:tabular-nums">{escape(banner.error)}</span></div>'
        '<div style="font-size:0.8em;line-height:1.35;margin-top:0.25em;min-height:2.7em">'
        f'<b id="fvs-state">{escape(banner.state)}</b> · '
        f'<span id="fvs-sentence">{_in_words(banner.sentence)}</span></div></div>'
    )


def lamps_html(lamps: tuple[Lamp, ...]) -> str:
    """What is well and what is not, two a row."""
    cells = []
    for lamp in lamps:
        colour, sign = _LAMPS[lamp.good]
        cells.append(
            '<div style="display:flex;align-items:center;gap:0.5em;min-width:0">'
            f'<span style="width:1.35em;height:1.35em;line-height:1.35em;text-align:center;'
            f"border-radius:50%;background:{colour};color:#101214;font-weight:700;"
            f'flex-shrink:0">{sign}</span>'
            '<span style="min-width:0;line-height:1.2">'
            f"{escape(lamp.name)}<br>"
            '<span style="opacity:0.65;font-variant-numeric:tabular-nums">'
            f"{escape(lamp.text)}</span></span></div>"
        )
    return (
        '<div style="margin:0 0.75em 0.6em 0.75em;font-size:0.8em;display:grid;'
        f'grid-template-columns:1fr 1fr;gap:0.5em 0.75em">{"".join(cells)}</div>'
    )


def remark_html(text: str, name: str) -> str:
    """A sentence for the person at the page; nothing where there is none."""
    if not text:
        return f'<div id="fvs-{name}"></div>'
    return (
        f'<div id="fvs-{name}" style="{_BOX}border:1px solid {GREY};padding:0.4em 0.7em;'
        f'font-size:0.8em;line-height:1.35">{_in_words(text)}</div>'
    )
