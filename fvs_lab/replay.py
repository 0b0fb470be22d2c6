"""``fvs_experiments replay BAG``: how each target of a recording went, without ROS."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby, pairwise
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fvs_controller_node.config import default_values
from fvs_controller_node.reasons import Reason, State
from fvs_controller_node.target_motion import continues
from fvs_lab.figures import bound_line, grid, legend, save
from fvs_ros import topics
from fvs_ros.arguments import Parser
from fvs_ros.joints import JointMap
from fvs_ros.kinds import KINDS, Kind, KindConfig
from fvs_ros.status import SILENT_S, vector
from fvs_ros.stop import EXIT_BAD_INPUT, EXIT_OK
from fvs_ros.vectors import plausible
from fvs_ros.yaml_text import read_yaml
from fvs_tools.bag_reader import BagError, open_bag
from fvs_tools.demo import table
from fvs_tools.score import SETTLED_ERROR_M, TargetScore, judge, largest_part_m

COMMAND = "fvs_experiments replay"
#: A stamp further than this from the arrival, s, is by another clock, or of a latched message.
_OWN_CLOCK_S = 5.0
#: A status shows the target so exactly, m.
_SHOWN_M = 0.001
_COLOURS = {
    State.WAITING.name: "#bbbbbb",
    State.READY.name: "#9ecae1",
    State.SERVOING.name: "#5fb88f",
    State.HOLDING.name: "#e69f00",
    State.FAULT.name: "#c0392b",
}
#: States of an arm that was started.
_STARTED = (State.SERVOING.name, State.HOLDING.name, State.FAULT.name)


class Series(NamedTuple):
    """Usable messages of one topic: times, s, (n,), in order, and numbers, (n, k)."""

    time_s: np.ndarray
    values: np.ndarray

    def between(self, start_s: float, end_s: float) -> Series:
        """The messages from a start to an end, both included."""
        start = np.searchsorted(self.time_s, start_s)
        end = np.searchsorted(self.time_s, end_s, side="right")
        return Series(self.time_s[start:end], self.values[start:end])


_NOTHING = Series(np.empty(0), np.empty((0, 0)))


class Status(NamedTuple):
    """A status of the controller: its arrival, s, and the target that it shows, m."""

    time_s: float
    state: str
    reason: str
    target_m: np.ndarray | None


@dataclass(frozen=True)
class Recording:
    """What a bag holds.

    ``series`` may have ``joints`` (velocities, rad/s), ``measured``, ``true`` and ``target``
    (features, m), ``velocities`` and ``positions`` (commands, rad/s and rad).
    """

    kind: Kind
    cut_off: bool
    #: First and last arrival, s.
    start_s: float
    end_s: float
    series: Mapping[str, Series]
    statuses: Sequence[Status]


class Target(NamedTuple):
    """A target: when it was set, s, the errors, m, at times, s, (n,), and the last reason."""

    set_s: float
    time_s: np.ndarray
    errors_m: np.ndarray
    score: TargetScore
    reason: str


# ---- reading --------------------------------------------------------------------------------


def read(path: Path, namespace: str | None = None) -> Recording:
    """Read a bag: the folder of a rosbag2 (MCAP or SQLite), or its one file.

    The namespace is that of the nodes; it is needed where the bag holds several robots. A
    ``ValueError`` says why a bag cannot be used.
    """
    with open_bag(path) as reader:
        started, declared = _notes(reader.notes)
        names = [declared.get(each.topic, each.topic) for each in reader.connections]
        ends = {name.rpartition("/")[2] for name in names}
        kinds = [name for name, kind in KINDS.items() if kind.topics.tool.name in ends]
        if kinds:
            started.setdefault("feature", kinds[0])
        started = default_values() | started
        kind = KindConfig.from_values(started).kind
        joint_map = JointMap(started["joint_names"], started["tf_prefix"])
        keys = {
            topics.JOINT_STATES: "joints",
            kind.topics.tool: "measured",
            kind.topics.truth: "true",
            kind.topics.target: "target",
            topics.COMMANDS: "velocities",
            topics.POSITION_COMMANDS: "positions",
            topics.CONTROLLER_STATUS: "status",
        }
        robots: dict[str, dict[tuple[str, str], str]] = {}
        for name, connection in zip(names, reader.connections, strict=True):
            for topic, key in keys.items():
                if name.endswith(f"/{topic.name}") and connection.msgtype == topic.type:
                    own = robots.setdefault(name.removesuffix(topic.name).strip("/"), {})
                    own[connection.topic, connection.msgtype] = key
        if namespace is not None:
            robots = {robot: own for robot, own in robots.items() if robot == namespace.strip("/")}
        if len(robots) > 1:
            listed = ", ".join(f"'/{robot}'" for robot in sorted(robots))
            raise BagError(f"it holds several robots, name one by --namespace: {listed}")
        key_of = next(iter(robots.values()), {})
        chosen = [each for each in reader.connections if (each.topic, each.msgtype) in key_of]
        arrivals_s, statuses = list[float](), list[Status]()
        rows_of: dict[str, list[tuple[float, np.ndarray]]] = {}
        for connection, time_ns, message in reader.decoded(chosen):
            key, arrival_s = key_of[connection.topic, connection.msgtype], time_ns * 1e-9
            arrivals_s.append(arrival_s)
            if key == "status":
                statuses.append(_status(arrival_s, message))
            else:
                with suppress(ValueError):  # the nodes refuse it, too
                    numbers = _numbers(message, kind, joint_map)
                    rows_of.setdefault(key, []).append((_time_s(arrival_s, message), numbers))
        if not arrivals_s:
            wanted, held = ", ".join(topic.name for topic in keys), ", ".join(names)
            raise BagError(f"it holds none of {wanted}; it has {held or 'no messages'}")
        return Recording(
            kind=kind,
            cut_off=reader.cut_off,
            start_s=arrivals_s[0],
            end_s=arrivals_s[-1],
            series={key: _series(rows) for key, rows in rows_of.items()},
            statuses=statuses,
        )


def _notes(notes: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """The controller's parameters as started; and remapped topics, with their declared names."""
    scenario, remaps = (read_yaml(str(notes.get(n, ""))) or {} for n in ("scenario", "remaps"))
    started: dict[str, Any] = {}
    for node, content in scenario.items():
        if node.endswith(topics.CONTROLLER):
            started |= content["ros__parameters"]
    return started, {other: name for name, other in remaps.items()}


def _time_s(arrival_s: float, message: Any) -> float:
    """The stamp of a message, s, or its arrival where it has none by the same clock."""
    if not hasattr(message, "header"):
        return arrival_s
    stamp_s = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
    return stamp_s if abs(arrival_s - stamp_s) < _OWN_CLOCK_S else arrival_s


def _numbers(message: Any, kind: Kind, joint_map: JointMap) -> np.ndarray:
    """Joint velocities, a command, or a feature; a ``ValueError`` if they cannot be used."""
    if hasattr(message, "velocity"):
        return joint_map.positions(message.name, message.velocity)
    values = np.array(message.data) if hasattr(message, "data") else kind.read(message)
    if not plausible(values):
        raise ValueError("not finite, or too large")
    return values


def _series(rows: list[tuple[float, np.ndarray]]) -> Series:
    """The messages with as many numbers as the first, in the order of their times."""
    size = rows[0][1].size
    alike = sorted((row for row in rows if row[1].size == size), key=lambda row: row[0])
    time_s, values = zip(*alike, strict=True)
    return Series(np.array(time_s), np.array(values))


def _status(arrival_s: float, message: Any) -> Status:
    values = {pair.key: pair.value for pair in message.values}
    target_m = vector(values, "target_{}_m")
    return Status(arrival_s, values.get("state", ""), values.get("reason", ""), target_m)


# ---- the targets ----------------------------------------------------------------------------


def targets(recording: Recording) -> list[Target]:
    """Score every target that the controller took, by the true feature where the bag has it."""
    messages = recording.series.get("target")
    if messages is None:
        return []
    changed = np.append(True, np.diff(messages.values, axis=0).any(axis=1))
    series = Series(messages.time_s[changed], messages.values[changed])
    steps_m = [recording.kind.minus(z, before) for before, z in pairwise(series.values)]
    steps = zip(steps_m, np.diff(series.time_s), strict=True)
    starts = [0, *(i for i, step in enumerate(steps, 1) if not continues(*step))]
    judged, end_s = [], inf
    for i, j in reversed(list(pairwise([*starts, None]))):
        run = Series(series.time_s[i:j], series.values[i:j])
        statuses = [each for each in recording.statuses if run.time_s[0] <= each.time_s < end_s]
        if statuses and not any(_shows(status, run) for status in statuses):
            continue  # the controller refused it
        judged.append(_judged(recording, run, statuses, end_s))
        end_s = run.time_s[0]
    return judged[::-1]


def _shows(status: Status, run: Series) -> bool:
    """Whether a status may be of this target; a moving one is not compared."""
    if status.target_m is None or len(run.time_s) > 1:
        return True
    return bool(np.abs(status.target_m - run.values[0, :3]).max() < _SHOWN_M)


def _judged(recording: Recording, run: Series, statuses: Sequence[Status], end_s: float) -> Target:
    """Judge a target until the next one, or until the arm is stopped or the target left."""
    kind, series, start_s = recording.kind, recording.series, run.time_s[0]
    begun, reason = False, ""
    for status in statuses:
        started = status.state in _STARTED and status.reason != Reason.SHUT_DOWN.name
        if begun and not (started and _shows(status, run)):
            end_s = status.time_s
            break
        begun, reason = begun or (started and _shows(status, run)), status.reason
    features = series.get("true") or series.get("measured") or _NOTHING
    time_s, features_m = features.between(start_s, end_s)
    wanted_m = run.values[np.searchsorted(run.time_s, time_s, side="right") - 1]
    errors_m = np.array(list(map(kind.minus, features_m, wanted_m)))
    if not time_s.size:
        time_s, errors_m = np.array([start_s]), np.full((1, kind.size), np.nan)
    speeds_rad_s = series.get("joints", _NOTHING).between(start_s, end_s).values
    if not speeds_rad_s.size:
        speeds_rad_s = np.full((1, 1), np.nan)
    score = judge(kind, time_s - start_s, errors_m, speeds_rad_s)
    return Target(start_s, time_s, largest_part_m(kind, errors_m), score, reason)


# ---- the figure -----------------------------------------------------------------------


def draw(path: Path, recording: Recording, judged: Sequence[Target]) -> None:
    """Draw errors and commands over time into a PNG file, and the controller's states as bands."""
    start_s = recording.start_s
    figure, axes = grid(2, 1, (12, 7), sharex=True)
    error, command = axes[:, 0]
    alike = groupby(recording.statuses, lambda status: (status.state, status.reason))
    bands = [(label, list(statuses)) for label, statuses in alike]
    ends_s = [*(statuses[0].time_s for _, statuses in bands[1:]), recording.end_s]
    for ((state, reason), statuses), next_s in zip(bands, ends_s, strict=False):
        begin_s, end_s = statuses[0].time_s, min(next_s, statuses[-1].time_s + SILENT_S)
        look = {"color": _COLOURS.get(state, "#555555"), "alpha": 0.3, "linewidth": 0.0}
        for axis in (error, command):
            axis.axvspan(begin_s - start_s, end_s - start_s, label=state, **look)
        if state in (State.HOLDING.name, State.FAULT.name):
            foot = error.get_xaxis_transform()
            error.text(begin_s - start_s, 0.02, reason, rotation=90, size=8, transform=foot)
    for number, target in enumerate(judged, start=1):
        time_s, error_mm = target.time_s - start_s, np.maximum(1e3 * target.errors_m, 0.01)
        error.plot(time_s, error_mm, color="black", linewidth=1.1)
        error.annotate(str(number), (time_s[0], error_mm[0]))
    bound_line(error, 1e3 * SETTLED_ERROR_M)
    error.set(yscale="log", ylabel=f"distance of the {recording.kind.what}\nto its target, mm")
    for kind, unit in (("velocities", "rad/s"), ("positions", "rad")):
        if kind in recording.series:
            time_s, values = recording.series[kind]
            labels = [f"joint {joint}" for joint in range(1, 1 + values.shape[1])]
            command.plot(time_s - start_s, values, linewidth=1.1, label=labels)
            command.set(ylabel=f"commanded joint {kind}, {unit}")
    command.set(xlabel="time since the recording began, s")
    legend(figure, 8)
    save(figure, path)


# ---- the program ----------------------------------------------------------------------------


def main(argv: list[str]) -> int:
    """Read a bag, write and print what is in it; the exit code says how it went."""
    parser = Parser(COMMAND, __doc__)
    parser.add_argument("bag", type=Path, help="folder of a rosbag2, or its one file")
    parser.add_argument(
        "--out", type=Path, help="folder of the results (default: out/replay/ and the bag's name)"
    )
    parser.add_argument("--namespace", help="namespace of the nodes, if the bag holds several")
    arguments = parser.parse_args(argv)
    out = arguments.out or Path("out/replay") / arguments.bag.resolve().name
    try:
        recording = read(arguments.bag, arguments.namespace)
        judged = targets(recording)
        out.mkdir(parents=True, exist_ok=True)
        draw(out / "replay.png", recording, judged)
    except ValueError as error:
        why = str(error)
    except OSError as error:
        why = f"cannot write to {out}: {error.strerror}; name another folder by --out"
    else:
        if recording.cut_off:
            print("The bag was cut off or damaged: messages are missing, perhaps the final stop.")
        notes = [
            f"set at {target.set_s - recording.start_s:.1f} s, {target.reason}" for target in judged
        ]
        print(table([target.score for target in judged], notes))
        print(f"figure: {out / 'replay.png'}")
        return EXIT_OK
    print(f"{COMMAND}: {why}", file=sys.stderr)
    return EXIT_BAD_INPUT
