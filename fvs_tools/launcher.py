"""``fvs_launch``: start a scenario's nodes, monitor them, and stop all cleanly."""

from __future__ import annotations

from fvs_ros import stop

stop.listen()

import argparse
import contextlib
import importlib.util
import json
import os
import shlex
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

from fvs_ros import console, topics
from fvs_ros.arguments import Parser
from fvs_ros.paths import output_file, program
from fvs_ros.stop import EXIT_BAD_INPUT, EXIT_FAILURE, EXIT_OK
from fvs_sim_node.robot import NEEDS_PYBULLET
from fvs_tools.scenario import (
    NODE_TABLE,
    Scenario,
    check_controller,
    load_scenario,
    params_yaml,
    scenario_names,
    unfit_model,
)
from fvs_tools.schemes import BEYOND, SCHEMES

_STOP_S = 5.0
_POLL_S = 0.05
_print_lock = threading.Lock()


class _Process:
    """One running node.

    It inherits the open file descriptor ``params`` of its parameters. ``terminal`` holds the
    descriptors of this program's output and error.
    """

    def __init__(
        self, name: str, arguments: list[str], params: int, terminal: tuple[int, int]
    ) -> None:
        self.name, self.entry = name, NODE_TABLE[name]
        self._asked = False
        # A task prints to the terminal itself (tables, a progress bar); other output is prefixed.
        out, err = terminal if self.entry.task else (subprocess.PIPE, subprocess.STDOUT)
        self.popen = subprocess.Popen(
            [*program(self.entry.module), *arguments],
            pass_fds=[params],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            env={
                # The launcher's prefix names the node already.
                "RCUTILS_CONSOLE_OUTPUT_FORMAT": "[{severity}] {message}",
                **os.environ,
                "PYTHONUNBUFFERED": "1",
                "PYTHONSAFEPATH": "1",  # for child processes of the nodes, Python 3.11 and later
            },
            # Ctrl-C reaches only the launcher, which stops the nodes in the right order.
            start_new_session=True,
        )
        self._reader = threading.Thread(target=self._forward, daemon=True)
        self._reader.start()

    def _forward(self) -> None:
        for line in self.popen.stdout or ():
            _say(line.decode("utf-8", "replace").rstrip(), self.name)

    def ask_to_end(self) -> None:
        """Send SIGTERM, if it still runs."""
        if self.popen.poll() is None:
            self._asked = True
            self.popen.terminate()

    def await_end(self, deadline_s: float) -> None:
        """Wait for its end and remaining output; kill it at a deadline on the steady clock."""
        try:
            self.popen.wait(max(0.0, deadline_s - time.monotonic()))
        except subprocess.TimeoutExpired:
            _say(f"{self.name} did not stop within {_STOP_S:g} s: killed")
            self.popen.kill()
            self.popen.wait()
        self._reader.join(_STOP_S)

    def ended_well(self) -> bool:
        """Whether it ended with 0, or by the requested signal before its handlers were set."""
        code = self.popen.returncode
        return code == 0 or (self._asked and code == -signal.SIGTERM)

    def end_text(self) -> str:
        """Its name, and how it ended."""
        code = self.popen.returncode
        how = f"exit code {code}" if code >= 0 else f"signal {stop.name_of(-code)}"
        return f"{self.name} ended with {how}"


def launch(scenario: Scenario, namespace: str = "", remaps: Sequence[str] = ()) -> int:
    """Start all nodes in order, wait for the first end or a signal, stop all.

    Returns 0 when ended by a signal or a task that succeeded; else the exit code of the node that
    ended it. ``remaps`` are rules ``from:=to`` for all nodes.
    """
    processes: list[_Process] = []
    with (
        # An unnamed file leaves nothing behind, however this program ends.
        tempfile.TemporaryFile("w+", encoding="utf-8") as params,
        console.never_blocking() as terminal,
    ):
        params.write(params_yaml(scenario))
        params.flush()
        common = ["--ros-args", "--params-file", f"/dev/fd/{params.fileno()}"]
        if namespace.strip("/"):
            common += ["-r", f"__ns:=/{namespace.strip('/')}"]
        common += [word for rule in remaps for word in ("-r", rule)]
        first = None
        try:
            for name in scenario:
                if stop.RECEIVED or first is not None:
                    break
                processes.append(_Process(name, common, params.fileno(), terminal))
                if name == topics.RECORDER:
                    first = _await_bag(processes[-1], scenario[name]["bag_dir"])
            if first is None:
                _say(f"started {', '.join(process.name for process in processes)}")
                first = _first_end(processes)
        finally:
            code = _stop_all(processes, first)
    return code


def _await_bag(recorder: _Process, bag_dir: str) -> _Process | None:
    """Wait until the recorder is subscribed; returns it if it ended without a bag."""
    folder = Path(bag_dir).expanduser()
    end_s = time.monotonic() + _STOP_S
    while not (stop.RECEIVED or folder.exists()) and time.monotonic() < end_s:
        if recorder.popen.poll() is not None:
            return recorder
        time.sleep(_POLL_S)
    return None


def _first_end(processes: Sequence[_Process]) -> _Process | None:
    """Wait for the end of a node that is needed; None at a signal."""
    running = list(processes)
    while not stop.RECEIVED:
        for process in running[:]:
            code = process.popen.poll()
            # An observer that refuses its parameters ends the scenario; other ends are tolerated.
            if code is not None and (not process.entry.observer or code == EXIT_BAD_INPUT):
                return process
            if code is not None:
                running.remove(process)
                _say(f"{process.end_text()}: the others go on")
        time.sleep(_POLL_S)
    return None


def _stop_all(processes: Sequence[_Process], first: _Process | None) -> int:
    """Stop the nodes; returns the launcher's exit code, where ``first`` ended the scenario.

    Nodes that command the arm stop first, so that their last zeros are received and recorded.
    Observers stop last.
    """
    code = None if first is None else first.popen.returncode
    done = first is not None and first.entry.task and code == EXIT_OK
    if first is not None and not (first.entry.task and code in (EXIT_OK, EXIT_FAILURE)):
        _say(f"{first.end_text()}: stopping the rest")  # a task has said itself how it ended
    elif stop.RECEIVED:
        _say(f"{stop.name_of(stop.RECEIVED[0])}: stopping")
    for role in ((True, False), (False, False), (False, True)):
        group = [p for p in processes if (p.entry.commands_arm, p.entry.observer) == role]
        for process in group:
            process.ask_to_end()
        deadline_s = time.monotonic() + _STOP_S
        for process in group:
            process.await_end(deadline_s)
    bad = [process for process in processes if not process.ended_well()]
    for process in bad:
        if process is not first:
            _say(process.end_text())
    if first is None or done:
        return EXIT_FAILURE if bad else EXIT_OK
    return max(first.popen.returncode, EXIT_FAILURE)


def _say(text: str, name: str = "fvs_launch") -> None:
    """Print a line; a closed standard output does not stop the monitoring of the nodes."""
    with _print_lock, contextlib.suppress(OSError, ValueError):
        print(f"[{name}] {text}", flush=True)


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        "fvs_launch",
        __doc__,
        {
            "scenarios": scenario_names(),
            "schemes": {name: each.description for name, each in {**SCHEMES, **BEYOND}.items()},
        },
    )
    parser.add_argument("scenario", help="a scenario YAML file, or the name of one in config/")
    parser.add_argument(
        "-p",
        "--param",
        action="append",
        default=[],
        metavar="[NODE:]NAME:=VALUE",
        help="set a parameter of one node, or of all that have it (repeatable); a node's --help, "
        "such as fvs_sim_node --help, lists its parameters",
    )
    parser.add_argument(
        "--scheme",
        default="",
        metavar="NAME",
        help="use the estimator method and the control law of a scheme, or of METHOD+LAW; -p wins",
    )
    parser.add_argument("--namespace", default="", help="ROS namespace of all nodes")
    parser.add_argument(
        "-r",
        "--remap",
        action="append",
        default=[],
        metavar="FROM:=TO",
        help="rename a topic or service in all nodes (repeatable)",
    )
    parser.add_argument(
        "--train",
        default="",
        metavar="MODEL",
        help="when the scenario has collected its data, fit a chain and networks to them, as "
        "fvs_train --method poe does, and write this model",
    )
    parser.add_argument(
        "--record",
        default="",
        metavar="DIR",
        help="record all topics into a new bag, with -p images:=false without the images, its "
        "largest part; docs/recording.md",
    )
    return parser


def _check(scenario: Scenario, arguments: argparse.Namespace) -> None:
    """Refuse, before a node starts, what cannot run to its end, as with a wrong model.

    The ``ValueError`` says what to install, or the commands that make a right model.
    """
    simulated = topics.SIM in scenario
    if simulated and importlib.util.find_spec("pybullet") is None:
        raise ValueError(NEEDS_PYBULLET)
    for values in scenario.values():
        if "output_path" in values:
            output_file(values["output_path"])
    if topics.CONTROLLER in scenario:
        check_controller(scenario[topics.CONTROLLER])
    if topics.ESTIMATOR not in scenario:
        return
    values, name = scenario[topics.ESTIMATOR], arguments.scenario
    if error := unfit_model(values):
        usual = "collect_minute" if simulated else "ur5_real_collect"
        collect = f"{name}_collect" if f"{name}_collect" in scenario_names() else usual
        missing = isinstance(error.__cause__, FileNotFoundError)  # else the file stays
        model = values["model_path"] if missing else "out/model.npz"
        same = [each for each in arguments.param if "model_path:=" not in each]
        # What the scenario's file sets holds for the collector, too.
        own = {**scenario.get(topics.SIM, {}), **values}
        usually = load_scenario(collect)[topics.COLLECTOR]
        arm = ("robot", "urdf_path") if simulated else ("joint_names",)
        written = {each.partition(":=")[0] for each in same}
        learn = [
            f"{key}:={json.dumps(own[key]) if isinstance(own[key], list) else own[key]}"
            for key in ("feature", "camera_mount", "cameras", *arm)
            if key not in written and own.get(key, usually.get(key)) != usually.get(key)
        ]
        learn += [each for each in same if _takes(collect, each)]
        scheme = f" --scheme {arguments.scheme}" if arguments.scheme else ""
        raise ValueError(
            f"{error}. A minute of motion gives one that fits:\n"
            f"  fvs_launch {collect} --train {shlex.quote(model)}{_words(learn)}\n"
            f"  fvs_launch {name}{scheme}{_words([*same, f'model_path:={model}'])}"
        ) from error


def _words(overrides: Iterable[str]) -> str:
    return "".join(f" -p {shlex.quote(each)}" for each in dict.fromkeys(overrides))


def _takes(scenario: str, override: str) -> bool:
    with contextlib.suppress(ValueError):
        return bool(load_scenario(scenario, [override]))
    return False


@console.reader_may_leave()
def main(argv: list[str] | None = None) -> int:
    """Run ``fvs_launch``; returns the exit code."""
    arguments = _parser().parse_args(argv)
    try:
        scenario = load_scenario(
            arguments.scenario, arguments.param, arguments.scheme, arguments.record
        )
        _check(scenario, arguments)
        if arguments.train:
            if topics.COLLECTOR not in scenario:
                raise ValueError(f"--train: {arguments.scenario} starts no {topics.COLLECTOR}")
            output_file(arguments.train)
    except (ValueError, OSError) as error:
        print(f"fvs_launch: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    if topics.SIM in scenario:
        # A simulated arm must not exchange messages with the robots of a laboratory network.
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    code = launch(scenario, arguments.namespace, arguments.remap)
    if not arguments.train or code != EXIT_OK or stop.RECEIVED:
        return code
    from fvs_estimator_node.collecting import CollectorConfig
    from fvs_tools import train  # slow to import

    data = scenario[topics.COLLECTOR].get("output_path", CollectorConfig.output_path)
    return train.main([data, "-o", arguments.train, "--method", "poe"])


if __name__ == "__main__":
    sys.exit(main())
