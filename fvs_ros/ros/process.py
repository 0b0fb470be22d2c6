"""One node as a process: its executor, help and clean shutdown."""

from __future__ import annotations

import gc
import json
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor

import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from fvs_ros import console, stop
from fvs_ros.arguments import listing
from fvs_ros.params import Parameter, ParameterSet
from fvs_ros.paths import find_file
from fvs_ros.ros.node import FvsNode, names_from_options
from fvs_ros.stop import EXIT_BAD_INPUT, EXIT_OK

try:
    from rclpy.experimental import EventsExecutor
except ImportError:  # before rclpy 7.1.4
    EventsExecutor = SingleThreadedExecutor

_SPIN_PERIOD_S = 0.05


def run(
    make: Callable[..., FvsNode | Sequence[FvsNode]],
    doc: str,
    parameters: Iterable[Parameter],
    takes: str = "",
) -> int:
    """Run one node, or several, in this process until a signal, its own wish, or an error.

    Signals end the spin loop, not the ROS context, so that ``finish`` can still send. A blocked
    terminal does not block the node: its output is dropped. ``doc``, the docstring of its module,
    and its parameters are for ``--help``; if ``takes`` says there what words the program takes,
    ``make`` gets them. Returns 0 after a signal or a finished task, 1 after an error, 2 after a
    wrong parameter or file.
    """
    stop.listen()
    # A lost first announcement costs a moment, not three seconds; only Fast DDS reads this.
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(find_file("quick_discovery.xml")))
    with console.never_blocking():
        if {"-h", "--help"} & set(sys.argv):
            print(_help(doc, parameters, takes))
            return EXIT_OK
        try:
            words = remove_ros_args(sys.argv)[1:]
            unknown = [word for word in words if not takes or word.startswith("-")]
            if unknown:  # rclpy ignores them, and the node would run with other values
                return _refused(
                    f"unknown argument {unknown[0]!r}; parameters and remaps stand "
                    "behind --ros-args, as in --ros-args -p name:=value; --help lists them"
                )
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        except RuntimeError as error:  # rcl's own: arguments or a parameter file it cannot read
            return _refused(str(error))
        try:
            known = ParameterSet(parameters)
            for name in names_from_options():
                known[name]  # an error if no node of this process has it
            made = make(words) if takes else make()
        except (ValueError, OSError, NameValidationException, ParameterException) as error:
            return _refused(str(error))
        else:
            return _spin([made] if isinstance(made, FvsNode) else made)
        finally:
            rclpy.try_shutdown()


def _help(doc: str, parameters: Iterable[Parameter], takes: str) -> str:
    """Help of a node: what it is for, and its parameters with defaults and ranges."""
    name = doc.split("`")[2]
    texts = {}
    for parameter in parameters:
        when = "; also while it runs" if parameter.live else ""
        default = f"{parameter.name}:={json.dumps(parameter.default)}"
        what = parameter.description[:1].upper() + parameter.description[1:].rstrip(".")
        texts[default] = f"{what} ({parameter.expected()}{when})"
    usage = " ".join(filter(None, (name, takes, "--ros-args")))
    return (
        f"{doc.strip().replace('`', '')}\n\n"
        f"usage: {usage} [-p NAME:=VALUE ...] [-r FROM:=TO ...] [--params-file FILE]\n\n"
        f"{listing('parameters and their defaults', texts)}"
    )


def _spin(nodes: Sequence[FvsNode]) -> int:
    events = all(node.keeps_subscriptions for node in nodes)
    executor: Executor = EventsExecutor() if events else SingleThreadedExecutor()
    for node in nodes:
        executor.add_node(node)
    # The garbage collector would look through all that was imported: 15 ms, two ticks.
    gc.collect()
    gc.freeze()
    try:
        while not (stop.RECEIVED or _exit_codes(nodes)) and rclpy.ok():
            executor.spin_once(timeout_sec=_SPIN_PERIOD_S)
    except ExternalShutdownException:
        pass
    finally:
        try:
            _finish(nodes)
        finally:
            executor.shutdown(timeout_sec=0.0)  # left to the garbage collector, it complains
            for node in nodes:
                node.destroy_node()
    return max(_exit_codes(nodes), default=EXIT_OK)


def _exit_codes(nodes: Iterable[FvsNode]) -> list[int]:
    return [node.exit_code for node in nodes if node.exit_code is not None]


def _finish(nodes: Sequence[FvsNode]) -> None:
    """Have all nodes finish at once: no arm moves on while another gets its last zeros."""
    with ThreadPoolExecutor(len(nodes)) as pool:
        for done in [pool.submit(node.finish) for node in nodes]:
            done.result()


def _refused(why: str) -> int:
    print(f"cannot start: {why}", file=sys.stderr, flush=True)
    return EXIT_BAD_INPUT
