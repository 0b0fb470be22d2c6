"""``fvs_experiments replay BAG``: how each target of a recording went, without ROS.

Not of webcams with names.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from itertools import dropwhile, pairwise, takewhile
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from fvs_controller_node.reasons import Reason
from fvs_ros import topics
from fvs_ros.arguments import Parser
from fvs_ros.joints import JointMap
from fvs_ros.kinds import KINDS, Kind
from fvs_ros.paths import output_file
from fvs_ros.status import vector
from fvs_ros.stop import EXIT_BAD_INPUT, EXIT_OK
from fvs_tools.bag_reader import BagError, open_bag
from fvs_tools.demo import TargetRecord, draw, table
from fvs_tools.score import FINAL_S

COMMAND = "fvs_experiments replay"
#: A stamp further than this from the arrival, s, is by another clock, or of a latched message.
_OWN_CLOCK_S = 5.0
#: A status shows the target so exactly, m.
_SHOWN_M = 0.001

#: Times, s, with what came then, in order.
_Rows = list[tuple[float, Any]]


def read(path: Path, namespace: str = "") -> tuple[list[TargetRecord], Sequence[str], bool]:
    """Read a bag: the folder of a rosbag2 (MCAP or SQLite), or its one file.

    Returns the targets that the controller took, each with its last reason as a note; the names of
    the joints; and whether the bag was cut off. The namespace is that of the nodes. A
    ``ValueError`` says why a bag cannot be used.
    """
    prefix = f"/{namespace.strip('/')}/".replace("//", "/")
    with open_bag(path) as reader:
        held = {each.topic: each.msgtype for each in reader.connections}
        kinds = [kind() for kind in KINDS.values() if prefix + kind.topics.target.name in held]
        if not kinds:
            targets = " or ".join(prefix + kind.topics.target.name for kind in KINDS.values())
            raise BagError(
                f"it has no {targets} (--namespace names the nodes'); it has "
                f"{', '.join(held)[:600] or 'no messages'}"
            )
        kind, rows = kinds[0], defaultdict[topics.Topic, _Rows](list)
        of_topic = {
            (prefix + topic.name, topic.type): topic
            for topic in (*kind.topics, topics.JOINT_STATES, topics.CONTROLLER_STATUS)
        }
        chosen = [each for each in reader.connections if (each.topic, each.msgtype) in of_topic]
        for connection, time_ns, message in reader.decoded(chosen):
            topic = of_topic[connection.topic, connection.msgtype]
            rows[topic].append((_time_s(1e-9 * time_ns, message), message))
        cut_off = reader.cut_off
    # Beside the arm's joint states there may be a gripper's.
    names = max((m.name for _, m in rows[topics.JOINT_STATES]), key=len, default=["joint"])
    joint_map = JointMap(names)
    records = _records(
        kind,
        _usable(rows[kind.topics.target], kind.read),
        _usable(rows[kind.topics.truth] or rows[kind.topics.tool], kind.read),
        _usable(rows[topics.JOINT_STATES], lambda m: joint_map.positions(m.name, m.velocity)),
        [
            (time_s, {pair.key: pair.value for pair in message.values})
            for time_s, message in rows[topics.CONTROLLER_STATUS]
        ],
    )
    if not records:
        raise BagError("no target in it was taken by the controller while ball or tag was seen")
    return records, names, cut_off


def _time_s(arrival_s: float, message: Any) -> float:
    """The stamp of a message, s, or its arrival where it has none by the same clock."""
    if not hasattr(message, "header"):
        return arrival_s
    stamp_s = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
    return stamp_s if abs(arrival_s - stamp_s) < _OWN_CLOCK_S else arrival_s


def _usable(rows: _Rows, content: Callable[[Any], np.ndarray]) -> _Rows:
    """The contents of messages, without those that the nodes refuse."""
    usable = []
    for time_s, message in rows:
        with suppress(ValueError):
            usable.append((time_s, content(message)))
    return sorted(usable, key=lambda row: row[0])


def _follows(values: Mapping[str, str], z: np.ndarray) -> bool:
    """Whether a status is of a started arm with this target."""
    shown_m = vector(values, "target_{}_m")
    return (
        values.get("state") in ("SERVOING", "HOLDING", "FAULT")
        and values.get("reason") != Reason.SHUT_DOWN.name
        and (shown_m is None or bool(np.abs(shown_m - z[:3]).max() < _SHOWN_M))
    )


def _records(
    kind: Kind, sent: _Rows, features: _Rows, velocities: _Rows, statuses: _Rows
) -> list[TargetRecord]:
    """A target is followed until the next one, or until the arm is stopped or the target left."""
    new = [(t, z) for i, (t, z) in enumerate(sent) if not i or np.any(z != sent[i - 1][1])]
    records = []
    for (start_s, z), (next_s, _) in pairwise([*new, (inf, None)]):
        if next_s - start_s < FINAL_S:
            continue  # a moving target's
        said = [(t, v, _follows(v, z)) for t, v in _between(statuses, start_s, next_s)]
        end_s, note = next_s, ""
        if said:
            from_first = dropwhile(lambda row: not row[2], said)
            own = [*takewhile(lambda row: row[2], from_first)]
            if not own:
                continue  # the controller refused it
            note = own[-1][1].get("reason", "")
            end_s = next_s if own[-1] is said[-1] else own[-1][0]
        truths, joints = (
            [(t - start_s, values) for t, values in _between(rows, start_s, end_s)]
            for rows in (features, velocities)
        )
        if truths:
            records.append(TargetRecord(kind, z, start_s, note, truths, joints))
    return records


def _between(rows: _Rows, start_s: float, end_s: float) -> _Rows:
    return [row for row in rows if start_s <= row[0] <= end_s]


def main(argv: list[str]) -> int:
    """Read a bag, and print and draw what is in it; the exit code says how it went."""
    parser = Parser(COMMAND, __doc__)
    parser.add_argument("bag", type=Path, help="folder of a rosbag2, or its one file")
    parser.add_argument(
        "--out", type=Path, help="folder of the figure (default: out/replay/ and the bag's name)"
    )
    parser.add_argument("--namespace", default="", help="namespace of the nodes")
    arguments = parser.parse_args(argv)
    folder = arguments.out or Path("out/replay") / arguments.bag.resolve().name
    try:
        figure = output_file(folder / "replay.png")
        records, joint_names, cut_off = read(arguments.bag, arguments.namespace)
        draw(figure, records, joint_names)
    except (ValueError, OSError) as error:
        print(f"{COMMAND}: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    if cut_off:
        print("The bag was cut off or damaged: messages are missing, perhaps the final stop.")
    print(f"{table(records)}\nfigure: {figure}")
    return EXIT_OK
