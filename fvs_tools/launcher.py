"""``fvs_launch``: start a scenario's nodes, watch over them, and bring all down cleanly."""

from __future__ import annotations

from fvs_ros import stop

stop.listen()

import argparse
import contextlib
import ctypes
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from fvs_ros import console
from fvs_ros.arguments import Parser
from fvs_ros.paths import program
from fvs_ros.stop import EXIT_BAD_INPUT, EXIT_FAILURE, EXIT_OK
from fvs_tools import markers, recording
from fvs_tools.scenario import (
    NODE_TABLE,
    Scenario,
    ScenarioError,
    checked_remap,
    enclave_arguments,
    load_scenario,
    scenario_names,
)
from fvs_tools.schemes import BEYOND, SCHEMES

_NAMESPACE = re.compile(r"([A-Za-z_]\w*(/[A-Za-z_]\w*)*)?", re.ASCII)
_STOP_S = 5.0
_POLL_S = 0.05
_PR_SET_PDEATHSIG = 1
#: The launcher's prefix names the node already.
_LOG_FORMAT = "[{severity}] {message}"


def _die_with_parent() -> None:
    """Have the kernel end this child should the launcher itself be killed (Linux)."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


@dataclass
class _Process:
    """One running node."""

    name: str
    popen: subprocess.Popen
    reader: threading.Thread
    stopped: bool = False

    def stop(self) -> None:
        """Ask it to end."""
        if self.popen.poll() is None:
            self.stopped = True
            self.popen.terminate()

    def ended_well(self) -> bool:
        """Whether it ended by itself with 0, or as asked (before its handlers stood, by signal)."""
        code = self.popen.returncode
        return code == 0 or (self.stopped and code == -signal.SIGTERM)


class Launcher:
    """Runs the processes of one scenario.

    Parameters
    ----------
    scenario : Scenario
        What to start.
    namespace : str
        ROS namespace of all nodes, or empty.
    remaps : sequence of str
        Rules ``from:=to`` for all nodes.
    """

    def __init__(self, scenario: Scenario, namespace: str = "", remaps: Sequence[str] = ()) -> None:
        self._scenario = scenario
        self._remaps = tuple(remaps)
        self._namespace = namespace.strip("/")
        self._processes: list[_Process] = []
        self._print_lock = threading.Lock()
        self._task_output: tuple[int | None, int | None] = (None, None)

    def run(self) -> int:
        """Start all, wait for the first end or a signal, stop all.

        Returns
        -------
        int
            0 when ended by a signal or a task that succeeded; else the exit code of the node
            that ended it.
        """
        with (
            # It has no name: whatever ends this program, nothing of it is left.
            tempfile.TemporaryFile("w+", encoding="utf-8") as params,
            console.never_blocking() as self._task_output,
        ):
            params.write(self._scenario.to_params_yaml())
            params.flush()
            try:
                for name in self._scenario.nodes:
                    if stop.RECEIVED:
                        break
                    self._start(name, params.fileno())
                    if name == recording.NODE and not self._await_recorder():
                        return self._end_unrecorded()
                for process in self._processes:
                    process.reader.start()
                self._say(f"started {', '.join(p.name for p in self._processes)}")
                first = self._wait()
                return self._end(first)
            finally:
                self._stop_all()

    def _start(self, name: str, params: int) -> None:
        entry = NODE_TABLE[name]
        command = [*program(entry.module), "--ros-args", "--params-file", f"/dev/fd/{params}"]
        if self._namespace:
            command += ["-r", f"__ns:=/{self._namespace}"]
        for rule in self._remaps:
            command += ["-r", rule]
        command += enclave_arguments(name, self._namespace, os.environ)
        popen = subprocess.Popen(
            command,
            pass_fds=[params],
            stdin=subprocess.DEVNULL,
            # A task speaks to the user itself (tables, a progress bar); others are prefixed.
            stdout=self._task_output[0] if entry.task else subprocess.PIPE,
            stderr=self._task_output[1] if entry.task else subprocess.STDOUT,
            env={
                "RCUTILS_CONSOLE_OUTPUT_FORMAT": _LOG_FORMAT,
                **os.environ,
                "PYTHONUNBUFFERED": "1",
                "PYTHONSAFEPATH": "1",  # for what the nodes start, from Python 3.11 on
            },
            # Ctrl-C reaches the launcher alone, which stops the nodes in the right order.
            start_new_session=True,
            # The console's threads alone run yet, and they hold no lock across the fork.
            preexec_fn=_die_with_parent,  # noqa: PLW1509
        )
        reader = threading.Thread(target=self._forward, args=(name, popen.stdout), daemon=True)
        self._processes.append(_Process(name, popen, reader))

    def _await_recorder(self) -> bool:
        """Have the recorder listen before the others speak; its folder tells that it does.

        Returns
        -------
        bool
            False if it has ended without one.
        """
        folder = Path(self._scenario.parameters[recording.NODE]["output_dir"]).expanduser()
        process = self._processes[-1].popen
        end_s = time.monotonic() + _STOP_S
        while not (stop.RECEIVED or folder.exists()) and time.monotonic() < end_s:
            if process.poll() is not None:
                return folder.exists()  # what stopped it later is no reason not to start
            time.sleep(_POLL_S)
        return True

    def _end_unrecorded(self) -> int:
        """Pass on what the recorder said, stop what runs, and tell that nothing is recorded."""
        for process in self._processes:
            process.reader.start()
        self._stop_all()
        code = self._processes[-1].popen.returncode
        self._say(f"{recording.NODE} ended with {_code_text(code)}: not started without it")
        return code if code > 0 else EXIT_FAILURE

    def _forward(self, name: str, stream: IO[bytes] | None) -> None:
        for line in stream or ():
            self._print(f"[{name}] {line.decode('utf-8', 'replace').rstrip()}")

    def _wait(self) -> _Process | None:
        gone: set[str] = set()
        while not stop.RECEIVED:
            for process in self._processes:
                code = process.popen.poll()
                if code is None or process.name in gone:
                    continue
                # An observer that refuses its parameters was wanted and will never be there.
                if not NODE_TABLE[process.name].observer or code == EXIT_BAD_INPUT:
                    return process
                gone.add(process.name)
                self._say(f"{process.name} ended with {_code_text(code)}: the others go on")
            time.sleep(_POLL_S)
        return None

    def _end(self, first: _Process | None) -> int:
        if first is None:
            self._say(f"{stop.name_of(stop.RECEIVED[0])}: stopping")
        elif first.name != self._scenario.task or first.popen.returncode != 0:
            self._say(
                f"{first.name} ended with {_code_text(first.popen.returncode)}: stopping the rest"
            )
        self._stop_all()
        bad = [p for p in self._processes if not p.ended_well()]
        for process in bad:
            if process is not first:
                self._say(f"{process.name} ended with {_code_text(process.popen.returncode)}")
        if first is None:
            return EXIT_FAILURE if bad else EXIT_OK
        if first.name == self._scenario.task and first.popen.returncode == 0:
            return EXIT_FAILURE if bad else EXIT_OK
        return first.popen.returncode if first.popen.returncode > 0 else EXIT_FAILURE

    def _stop_all(self) -> None:
        """Stop the nodes that command the arm first, and those that look on last.

        The last zeros need a listener, and belong into a recording.
        """
        for turn in range(3):
            group = [p for p in self._processes if _turn(p.name) == turn]
            for process in group:
                process.stop()
            deadline_s = time.monotonic() + _STOP_S
            for process in group:
                try:
                    process.popen.wait(max(0.0, deadline_s - time.monotonic()))
                except subprocess.TimeoutExpired:
                    self._say(f"{process.name} did not stop within {_STOP_S:g} s: killed")
                    process.popen.kill()
                    process.popen.wait()
                if process.reader.ident is not None:
                    process.reader.join(_STOP_S)

    def _say(self, text: str) -> None:
        self._print(f"[fvs_launch] {text}")

    def _print(self, line: str) -> None:
        """Print a line; without a reader the nodes are watched and drained all the same."""
        with self._print_lock, contextlib.suppress(OSError, ValueError):
            print(line, flush=True)


def _turn(name: str) -> int:
    """When a node is stopped: 0 first, 2 last."""
    entry = NODE_TABLE[name]
    return 0 if entry.commands_arm else 2 if entry.observer else 1


def _code_text(code: int) -> str:
    return f"exit code {code}" if code >= 0 else f"signal {stop.name_of(-code)}"


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        "fvs_launch",
        __doc__,
        {
            "scenarios": scenario_names(),
            "schemes": {one.name: one.description for one in (*SCHEMES.values(), *BEYOND.values())},
            "nodes": dict.fromkeys(NODE_TABLE, "its --help lists its parameters"),
        },
    )
    parser.add_argument("scenario", help="a scenario YAML file, or the name of one in config/")
    parser.add_argument(
        "-p",
        "--param",
        action="append",
        default=[],
        metavar="[NODE:]NAME:=VALUE",
        help="override a parameter (repeatable), of one node or of every node that has it",
    )
    parser.add_argument(
        "--scheme",
        default="",
        metavar="NAME",
        help="estimator method and control law by one name; -p wins over it",
    )
    parser.add_argument("--namespace", default="", help="ROS namespace of all nodes")
    parser.add_argument(
        "-r",
        "--remap",
        action="append",
        default=[],
        metavar="FROM:=TO",
        help="give a topic or service another name, in all nodes (repeatable)",
    )
    parser.add_argument(
        "--record",
        default="",
        metavar="DIR",
        help="record all topics, and markers to look at, into a bag there, which must not exist "
        "yet; docs/recording.md",
    )
    parser.add_argument(
        "--record-without-images",
        dest="images",
        action="store_false",
        help="with --record: leave the images out, which are most of a bag, and which a simulator "
        "would have to draw",
    )
    return parser


def _recorded(scenario: Scenario, arguments: argparse.Namespace) -> Scenario:
    """The scenario with its overrides, and with a recorder if one is wanted."""
    # A parameter without a node is not meant for what is added: `output_dir` is the demo's.
    added = tuple(f"{name}:" for name in (recording.NODE, markers.NODE))
    own = [text for text in arguments.param if text.startswith(added)]
    scenario = scenario.with_overrides([text for text in arguments.param if text not in own])
    if arguments.record:
        scenario = scenario.with_recording(arguments.record, arguments.images)
    return scenario.with_overrides(own)


@console.reader_may_leave()
def main(argv: list[str] | None = None) -> int:
    """Run ``fvs_launch``; the exit code says how it went."""
    arguments = _parser().parse_args(argv)
    try:
        if not arguments.images and not arguments.record:
            raise ScenarioError("--record-without-images needs --record")
        scenario = load_scenario(arguments.scenario)
        if arguments.scheme:
            scenario = scenario.with_scheme(arguments.scheme)
        scenario = _recorded(scenario, arguments)
        scenario.check_models()
        remaps = [checked_remap(text) for text in arguments.remap]
        if not _NAMESPACE.fullmatch(arguments.namespace.strip("/")):
            raise ScenarioError(
                f"--namespace must be names of letters, digits and _ with / between, "
                f"got '{arguments.namespace}'"
            )
    except ScenarioError as error:
        print(f"fvs_launch: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    if "fvs_sim_node" in scenario.nodes:
        # A simulated arm must not hear, or be heard by, the robots of a laboratory network.
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return Launcher(scenario, arguments.namespace, remaps).run()


if __name__ == "__main__":
    sys.exit(main())
