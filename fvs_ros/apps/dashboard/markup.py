"""The parts of the page that are plain HTML: banner, lamps, answers."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

from fvs_ros.apps.dashboard.view import Banner, Detail, Lamp

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

#: Without a sign of life for so long, a page says that its program has ended, s.
LOST_S = 5.0

#: A lamp says how it is by its sign, too, not by its colour alone.
_LAMPS = {True: (GREEN, "✓"), False: (VERMILLION, "✗"), None: (GREY, "?")}

_BOX = "margin:0 0.75em 0.4em 0.75em;border-radius:6px;"
#: Two columns, for what is looked at one after another.
_GRID = (
    "margin:0 0.75em 0.4em 0.75em;font-size:0.8em;display:grid;grid-template-columns:1fr 1fr;"
    "line-height:1.2;"
)

#: More letters than this stand on a line of their own.
_SHORT = 16

#: What the controller asks for by a service's name stands on the page as a button.
_BUTTONS = {
    "call ~/start": "press Start",
    "publish one, or call ~/set_current_as_target": "set one, or press Set current as target",
}


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


def _in_words(sentence: str) -> str:
    """A sentence of the controller as markup, in the page's own words."""
    for service, button in _BUTTONS.items():
        sentence = sentence.replace(service, button)
    return escape(sentence)


def banner_html(banner: Banner) -> str:
    """The state, the distance to go and the controller's sentence, to be read from afar."""
    return (
        f'<div style="{_BOX}background:{banner.colour};color:#fff;padding:0.5em 0.8em;">'
        '<div style="display:flex;justify-content:space-between;align-items:baseline;gap:0.5em">'
        # One line, whatever there is to say: the buttons below stay where they are.
        '<span style="flex:1 1 0;width:0;overflow:hidden;text-overflow:ellipsis;white-space:nowrap;'
        f'font-size:1.3em;font-weight:650">{escape(banner.title)}'
        '</span><span id="fvs-error" style="font-size:1.4em;font-weight:650;white-space:nowrap;'
        f'font-variant-numeric:tabular-nums">{escape(banner.error)}</span></div>'
        '<div style="font-size:1.1em;line-height:1.3;margin-top:0.15em;min-height:2.6em">'
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
            '<span style="min-width:0">'
            f"{escape(lamp.name)}<br>"
            '<span style="opacity:0.65;font-variant-numeric:tabular-nums">'
            f"{escape(lamp.text)}</span></span></div>"
        )
    return f'<div style="{_GRID}gap:0.4em 0.75em">{"".join(cells)}</div>'


def details_html(details: tuple[Detail, ...]) -> str:
    """What the troubleshooting asks for: short ones two a row, sentences below."""
    cells = []
    for detail in details:
        wide = "" if len(detail.text) <= _SHORT else "grid-column:1 / -1;"
        cells.append(
            f'<div style="{wide}min-width:0;font-variant-numeric:tabular-nums">'
            f'<span style="opacity:0.65">{escape(detail.name)}</span> '
            f"{escape(detail.text)}</div>"
        )
    return f'<div id="fvs-details" style="{_GRID}gap:0.2em 0.75em">{"".join(cells)}</div>'


def answer_html(text: str) -> str:
    """What was last answered to a person's wish; its place is kept where there is nothing."""
    return (
        f'<div id="fvs-answer" style="{_BOX}border:1px solid {GREY if text else "transparent"};'
        'padding:0.25em 0.7em;font-size:0.9em;line-height:1.3;min-height:1.9em">'
        f"{_in_words(text)}</div>"
    )


def alive_html(beat: int) -> str:
    """A warning that shows itself where no further beat comes: the program has ended.

    A page without its program shows what it was told last, and for ever; nobody is left to change
    it but the browser itself.
    """
    name = f"fvs-lost-{beat % 2}"  # another one: or the browser might go on with the old wait
    return (
        f"<style>@keyframes {name} {{from {{max-height:0;opacity:0}} "
        "to {max-height:20em;opacity:1}}</style>"
        f'<div id="fvs-lost" style="margin:0 0.75em;overflow:hidden;max-height:0;opacity:0;'
        f'animation:{name} 0.1s linear {LOST_S:g}s forwards">'
        f'<div style="margin-bottom:0.4em;padding:0.5em 0.8em;border-radius:6px;'
        f'background:{VERMILLION};color:#101214;font-weight:650;line-height:1.3">'
        f"No word from this page's program for {LOST_S:g} s: what stands here is old, and Stop "
        "does nothing. Use the robot's own stop. Where the program runs again, reload the page."
        "</div></div>"
    )


def legend_html(title: str, signs: Iterable[tuple[str, tuple[int, int, int], str]]) -> str:
    """What the colours of a picture mean: a sign, its colour (RGB), and words, of each."""
    cells = [f'<span style="opacity:0.65">{escape(title)}</span>'] + [
        f'<span style="white-space:nowrap"><span style="color:rgb{colour}">{sign}</span> '
        f"{escape(words)}</span>"
        for sign, colour, words in signs
    ]
    return (
        '<div style="margin:0 0.75em;font-size:0.75em;line-height:1.3;display:flex;gap:0.9em">'
        f"{''.join(cells)}</div>"
    )


def notes_html(notes: tuple[str, ...]) -> str:
    """Sentences about the page itself."""
    lines = "".join(f"<div>{_in_words(note)}</div>" for note in notes)
    return (
        f'<div id="fvs-notes" style="margin:0 0.75em;font-size:0.8em;line-height:1.3;opacity:0.8">'
        f"{lines}</div>"
    )
