"""What the nodes said, in order: states and reasons, limits, warnings, silences."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fvs_lab.replay.data import Recording, Said
from fvs_lab.replay.timing import gaps
from fvs_ros.joints import N_JOINTS
from fvs_ros.status import SILENT, SILENT_S

SERVOING, SETTLED, SHUT_DOWN = "SERVOING", "SETTLED", "SHUT_DOWN"
#: Of a controller that was ended in order, when the loop was.
ENDED = "ENDED"
#: A loop that is ended takes no longer than this from the controller's last word to the last joint
#: state, s.
_ENDING_S = 5.0
#: A line of the log that came again within this is the same trouble, s.
_AGAIN_S = 5.0
#: A joint that is further from where it was, rad, or quicker, rad/s, than this moves.
_MOVED_RAD, _MOVES_RAD_S = 0.01, 0.02


@dataclass(frozen=True)
class Spell:
    """A time in which something stayed as it was.

    Parameters
    ----------
    start_s, end_s : float
        From and to, s.
    what : str
        The controller's state, or the name of a limit.
    reason : str
        The reason's name; empty for a limit.
    sentence : str
        The first sentence about it.
    """

    start_s: float
    end_s: float
    what: str
    reason: str = ""
    sentence: str = ""


@dataclass(frozen=True)
class Event:
    """A moment worth a line.

    Parameters
    ----------
    time_s : float
        When, s.
    who : str
        The node or topic.
    text : str
        What was.
    times : int
        How often, in quick succession.
    """

    time_s: float
    who: str
    text: str
    times: int = 1


def states(recording: Recording) -> list[Spell]:
    """The controller's states and reasons in order.

    ``SILENT`` where it said nothing; ``ENDED`` where it says no more, as the loop was being ended:
    the controller is stopped first and the recorder last.
    """
    statuses = recording.said.get("controller", ())
    found: list[Spell] = []
    for status, end_s, next_s in _with_ends(recording, statuses):
        state = status.values.get("state", "unknown")
        reason = status.values.get("reason", "")
        if found and (found[-1].what, found[-1].reason) == (state, reason):
            last = found[-1]
            found[-1] = Spell(last.start_s, end_s, state, reason, last.sentence)
        else:
            found.append(Spell(status.arrival_s, end_s, state, reason, status.text))
        if end_s < next_s:
            found.append(Spell(end_s, next_s, SILENT, "", "no word from the controller"))
    if not found or found[-1].what != SILENT:
        return found
    *before, last, silent = found
    ended_s = _ended_s(recording)
    if ended_s is None:
        return found
    ended_s = min(ended_s, last.end_s)
    ended = Spell(ended_s, silent.end_s, ENDED, "", "the loop was being ended")
    return [*before, replace(last, end_s=ended_s), ended]


def _ended_s(recording: Recording) -> float | None:
    """When the controller ended in order, s; None where it was killed, or that is not known.

    Its last status may say so. Its last commands do: zeros, after which the joint states end, too.
    One that was killed leaves the arm moving, and one whose robot goes on was alone in ending.
    """
    status = recording.said["controller"][-1]
    commands, joints = recording.series.get("commands"), recording.series.get("joints")
    last_s = status.arrival_s
    if commands is not None:
        last_s = max(last_s, float(commands.arrival_s[-1]))
    if status.values.get("reason") == SHUT_DOWN:
        return last_s
    if commands is None or joints is None or commands.values[-1].any():
        return None
    return last_s if joints.arrival_s[-1] - status.arrival_s < _ENDING_S else None


def limits(recording: Recording) -> list[Spell]:
    """Spells of servoing in which a limit shaped the command, as ten statuses a second tell it."""
    found: list[Spell] = []
    active = ""
    for status, end_s, _ in _with_ends(recording, recording.said.get("controller", ())):
        servoing = status.values.get("state") == SERVOING
        previous, active = active, _unnumbered(status.values.get("active_limit", ""))
        active = active if servoing else ""
        if not active:
            continue
        if active == previous:
            found[-1] = Spell(found[-1].start_s, end_s, active)
        else:
            found.append(Spell(status.arrival_s, end_s, active))
    return found


def _unnumbered(limit: str) -> str:
    """A limit's name without the number of the moment, as in "near singular (0.071 m/rad)"."""
    return re.sub(r" \([^)]*\)", "", limit)


def moved_before_s(recording: Recording) -> float:
    """How long before the first command in the bag the arm moved already, s; 0 if it did not."""
    joints, commands = recording.series.get("joints"), recording.series.get("commands")
    if joints is None or commands is None:
        return 0.0
    early = joints.arrival_s < commands.arrival_s[0]
    values = joints.values[early]
    moves = (np.abs(values[:, :N_JOINTS] - joints.values[0, :N_JOINTS]) > _MOVED_RAD).any(axis=1)
    moves |= (np.abs(values[:, N_JOINTS:]) > _MOVES_RAD_S).any(axis=1)  # not where it is unknown
    if not moves.any():
        return 0.0
    return float(commands.arrival_s[0] - joints.arrival_s[early][moves][0])


def on_the_way(recording: Recording) -> list[Spell]:
    """Spells in which the arm was on its way to a target: servoing, and not settled on it."""
    return [one for one in states(recording) if one.what == SERVOING and one.reason != SETTLED]


def events(recording: Recording) -> list[Event]:
    """Warnings of the log, changed parameters, silences of inputs and controller, in order.

    The controller's own warnings are its states, and not said twice; others use the same words.
    """
    spells = states(recording)
    told = {spell.what for spell in spells}
    # The log has a node's full name with dots.
    controller = {
        status.who.strip("/").replace("/", ".") for status in recording.said.get("controller", ())
    }
    found = [
        Event(line.arrival_s, line.who, line.text)
        for line in recording.said.get("log", ())
        if line.who not in controller or line.text.partition(":")[0] not in told
    ]
    found += [
        Event(one.arrival_s, one.who, one.text) for one in recording.said.get("parameters", ())
    ]
    found += [
        Event(gap.start_s, gap.topic, f"silent for {gap.length_s:.2f} s") for gap in gaps(recording)
    ]
    found += [
        Event(spell.start_s, "the controller", f"silent for {spell.end_s - spell.start_s:.2f} s")
        for spell in spells
        if spell.what == SILENT
    ]
    return _joined(sorted(found, key=lambda event: event.time_s))


def _with_ends(recording: Recording, statuses: Sequence[Said]) -> list[tuple[Said, float, float]]:
    """Each status, until when it holds, and when the next one came, or the bag ended, s.

    What was said a second ago says nothing of now: the controller may be dead.
    """
    following = [status.arrival_s for status in statuses[1:]] + [recording.end_s]
    return [
        (status, min(next_s, status.arrival_s + SILENT_S), next_s)
        for status, next_s in zip(statuses, following, strict=bool(statuses))
    ]


def _joined(events: Sequence[Event]) -> list[Event]:
    """The events, each of those that come again and again once."""
    found: list[Event] = []
    latest: dict[tuple[str, str], tuple[int, float]] = {}
    for event in events:
        # "silent for 0.12 s" and "silent for 0.14 s" are the same trouble.
        key = (event.who, event.text.partition(" for ")[0])
        index, time_s = latest.get(key, (-1, float("-inf")))
        if event.time_s - time_s < _AGAIN_S:
            first = found[index]
            found[index] = Event(first.time_s, first.who, first.text, first.times + 1)
        else:
            index = len(found)
            found.append(event)
        latest[key] = (index, event.time_s)
    return found
