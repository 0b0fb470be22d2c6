"""The first section of a recording's page: states and reasons, limits, warnings, silences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fvs_lab.replay import story
from fvs_lab.replay.data import Recording
from fvs_lab.replay.overview import overview
from fvs_lab.replay.runs import Target
from fvs_lab.replay.tables import shortened
from fvs_lab.report import Figure, Report, Table

HAPPENED = "happened"
#: A table of the page is no longer than this, rows: most from its beginning, and its end.
_MOST, _OF_THE_END = 60, 20


def happened(
    recording: Recording, targets: Sequence[Target], bounds_m: Sequence[float], folder: Path
) -> Report:
    """Tell what the controller did, and why, and draw it."""
    states, limits, events = (
        story.states(recording),
        story.limits(recording),
        story.events(recording),
    )
    figure = overview(recording, targets, bounds_m, folder)
    tables = []
    if states:
        tables.append(
            Table(
                "The controller’s states and reasons.",
                ["from, s", "for, s", "state", "reason", "said"],
                _cut(
                    [
                        [
                            _seconds(one.start_s - recording.start_s),
                            _seconds(one.end_s - one.start_s),
                            one.what,
                            one.reason,
                            one.sentence,
                        ]
                        for one in states
                    ]
                ),
            )
        )
    if events:
        tables.append(
            Table(
                "Warnings of all nodes, parameters that were changed, inputs of the controller "
                "that were silent for longer than it waits, and its own silences.",
                ["at, s", "who", "what", "times"],
                _cut(
                    [
                        [
                            _seconds(one.time_s - recording.start_s),
                            one.who,
                            one.text,
                            str(one.times),
                        ]
                        for one in events
                    ]
                ),
            )
        )
    if limits:
        tables.append(_limits_table(limits, story.on_the_way(recording)))
    return Report(
        name=HAPPENED,
        title="What happened",
        question="What did the controller do, when, and why?",
        setup=[
            f"{recording.end_s - recording.start_s:.1f} s, "
            f"{sum(len(flow.arrival_s) for flow in recording.flows.values())} messages of "
            f"{len(recording.flows)} topics. {_origin(recording)}"
            + ("" if states else " The controller’s status is not in the bag."),
            *_incomplete(recording, targets),
        ],
        figures=[
            Figure(
                figure,
                "From above: the controller’s state, and when a limit shaped its command; the "
                "distance of the ball to the target, a colour each; the joints’ velocities as "
                "measured and as commanded, between the limits that the controller keeps.",
            )
        ],
        tables=tables,
        data={
            "cut_off": recording.cut_off,
            "scenario": recording.scenario,
            "states": [_since(recording, one) for one in states],
            "limits": [_since(recording, one) for one in limits],
            "events": [_since(recording, one) for one in events],
        },
    )


def _incomplete(recording: Recording, targets: Sequence[Target]) -> list[str]:
    """What is missing at the ends of the bag, a paragraph each."""
    found = []
    if recording.cut_off:
        found.append(
            "The bag was cut off: its recorder was killed, or it was not copied whole. What is "
            "shown ends before the run did: the last second or more is missing, and with it the "
            "arm’s coming to rest. What it leaves unknown of the last target is not guessed."
        )
    moved_s = story.moved_before_s(recording)
    if moved_s:
        found.append(
            f"The arm moved already {moved_s:.2f} s before the first command in the bag: its "
            "beginning is missing, or something else moved the arm."
        )
    if targets and targets[0].begins_late:
        found.append(
            "The beginning of the first target is missing: the first position of the ball came "
            f"{targets[0].record.time_s[0]:.2f} s after it was given, so that its start distance "
            "is not known, and its path is what is left of it."
        )
    return found


def _origin(recording: Recording) -> str:
    words = [f"Recorded with fvs_ros {recording.version}." if recording.version else ""]
    values = recording.scenario
    method = values.get("fvs_estimator_node", {}).get("method")
    law = values.get("fvs_controller_node", {}).get("law")
    if method and law:
        words.append(f"Method {method}, law {law}.")
    if not values:
        words.append(
            "The bag does not say how the nodes were started: the limits drawn and the bounds of "
            "settling are the defaults."
        )
    return " ".join(filter(None, words))


def _limits_table(limits: Sequence[story.Spell], ways: Sequence[story.Spell]) -> Table:
    """How long each limit shaped the command, in all and on the way to targets."""
    way_s = sum(one.end_s - one.start_s for one in ways)
    rows = []
    for name in sorted({spell.what for spell in limits}):
        spells = [spell for spell in limits if spell.what == name]
        total_s = sum(one.end_s - one.start_s for one in spells)
        common_s = sum(_common_s(one, way) for one in spells for way in ways)
        share = f"{100 * common_s / way_s:.0f} %" if way_s else ""
        rows.append((total_s, [name, _seconds(total_s), share]))
    return Table(
        "Limits that shaped the command, as far as the status tells, ten times a second. On the "
        "way is SERVOING before the ball is SETTLED on the target.",
        ["limit", "for, s", "of the time on the way"],
        [row for _, row in sorted(rows, key=lambda one: -one[0])],
    )


def _common_s(one: story.Spell, other: story.Spell) -> float:
    return max(0.0, min(one.end_s, other.end_s) - max(one.start_s, other.start_s))


def _seconds(value_s: float) -> str:
    return f"{value_s:.2f}"


def _since(recording: Recording, one: story.Spell | story.Event) -> dict[str, Any]:
    """As a dictionary, with times since the recording's start, s, as the tables have them."""
    times_s = {"start_s", "end_s", "time_s"}
    return {
        name: value - recording.start_s if name in times_s else value
        for name, value in asdict(one).items()
    }


def _cut(rows: Sequence[Sequence[str]]) -> Sequence[Sequence[str]]:
    return shortened(rows, _MOST, _OF_THE_END, "in results.json")
