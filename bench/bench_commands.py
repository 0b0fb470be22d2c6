"""Every command of README and guides, run as it is written: exit code and seconds.

It runs in a scratch folder beside this environment's programs, page by page, in order, in simulated
time. A program that serves until Ctrl-C runs beside those after it. Pages with a stand-in for a
robot run beside that. What needs an installed ROS, hardware, your files or hours is named, not run.

    python -m bench commands ./docs/tags.md     one page
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from bench import ROOT
from fvs_ros import topics
from fvs_tools.scenario import NODE_TABLE, load_scenario

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
#: What serves has started if it still runs after this time; others end within the longer one, s.
_STARTED_S, _LONGEST_S = 20.0, 1500.0
_SIMULATED = ["-p", "simulated_time:=true", "-p", "use_sim_time:=true"]
#: A stand-in's images are drawn whole: four times fewer pixels four times faster. Tags need them.
_SMALL = ["-p", "image_width:=320", "-p", "image_height:=240"]
_NOT_RUN = {
    r"source|export|cd": "of the shell",
    r"sudo|(\S*pip|rosdep) install|git ": "installs",
    r"make (experiments|bench|model|test|coverage|docs)": "takes long",
    r".*(my_bag|poses\.csv|odd_run|\./FOLDER)": "needs your files",
    r"fvs_servo .*retreat": "needs what you taught",
}


def commands(page: Path) -> list[str]:
    """The commands of a page's ``sh`` blocks, each in a line, without comments."""
    blocks = re.findall(r"^ *```sh\n(.*?)^ *```", page.read_text(encoding="utf-8"), re.M | re.S)
    lines = re.sub(r"\\\n\s*", "", "\n".join(blocks)).splitlines()
    plain = (re.sub(r"(^|\s)#.*", "", line).strip().removeprefix(".venv/bin/") for line in lines)
    return [line for line in plain if line]


def launched(words: list[str]) -> list[str]:
    """Arguments of ``fvs_launch``, also where ``make`` runs it; empty for other commands."""
    if words[:2] in (["make", "demo"], ["make", "dashboard"]):
        extra = next((word[5:] for word in words if word.startswith("ARGS=")), "")
        return [words[1], *shlex.split(extra)]
    return words[1:] if words[0] == "fvs_launch" else []


def _plan(words: list[str], standin: str) -> tuple[list[str], bool, str]:
    """What to run, whether it serves until Ctrl-C, and why it is not run."""
    line = " ".join(words)
    for pattern, why in _NOT_RUN.items():
        if re.match(pattern, line):
            return words, False, why
    if not shutil.which(words[0]):
        return words, False, f"there is no {words[0]} here"
    arguments = launched(words)
    if words[0] == "make":
        words = ["make", "-o", ".venv/.installed-lab", *words[1:]]
    if not arguments:
        return words, words[0] == "fvs_dashboard" or words[0].endswith("_node"), ""
    overrides = [arguments[i + 1] for i, word in enumerate(arguments) if word == "-p"]
    record = "out/not_there" if "--record" in arguments else ""
    scenario = load_scenario(arguments[0], overrides, record=record)
    serves = not any(NODE_TABLE[node].task for node in scenario)
    if topics.SIM in scenario:
        small = _SMALL if "_standin" in line and "feature" not in line else []
        return ["fvs_launch", *arguments, *_SIMULATED, *small], serves, ""
    if not standin or arguments[0].partition("_")[0] != standin.partition("_")[0]:
        return words, serves, "needs a robot"
    return ["fvs_launch", *arguments, *_SIMULATED[2:]], serves, ""


class _Runner:
    """Runs commands in a folder, those that serve beside the others."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._servers: list[tuple[str, subprocess.Popen[bytes], float]] = []

    def run(self, words: list[str], serves: bool, text: str) -> bool:
        """Run a command; whether it went well, or, if it serves, whether it started."""
        begin_s = time.perf_counter()
        with (self._folder / "commands.log").open("ab") as log:
            log.write(f"\n$ {text}\n".encode())
            log.flush()
            process = subprocess.Popen(
                words,
                cwd=self._folder,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self._servers.append((text, process, begin_s))
        with suppress(subprocess.TimeoutExpired):
            process.wait(_STARTED_S if serves else _LONGEST_S)
        return (serves and process.poll() is None) or self.stop(len(self._servers) - 1)

    def stop(self, keep: int = 0) -> bool:
        """End the newest by Ctrl-C, unless they have ended; whether all went well."""
        good = True
        while len(self._servers) > keep:
            text, process, begin_s = self._servers.pop()
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                try:
                    process.wait(_STARTED_S)
                except subprocess.TimeoutExpired:
                    os.killpg(process.pid, signal.SIGKILL)
                    process.wait()
            code, spent_s = process.returncode, time.perf_counter() - begin_s
            print(f"{code:4d} {spent_s:6.0f} s  {text}", flush=True)
            good &= code == 0
        return good


def check(page: Path, runner: _Runner) -> int:
    """Run a page's commands; returns how many did not end well."""
    print(f"-- {page.relative_to(ROOT)}", flush=True)
    found = re.search(r"fvs_launch (\w+_standin[^`\n#]*)", page.read_text(encoding="utf-8"))
    standin = found.group(1).strip() if found else ""
    bad, beside = 0, False
    for text in commands(page):
        words, serves, why = _plan(shlex.split(text), standin)
        if why:
            print(f"   -        -  {text}   ({why})", flush=True)
            continue
        if launched(words):  # each robot, or its stand-in, and what serves it
            needs = "simulated_time:=true" not in words
            bad += not runner.stop(int(needs and beside))
            if needs and not beside:
                stand_in, _, _ = _plan(["fvs_launch", *shlex.split(standin)], standin)
                bad += not runner.run(stand_in, True, f"fvs_launch {standin}")
            beside = needs
        if "_standin" not in text:
            bad += not runner.run(words, serves, text)
    return bad + (not runner.stop())


def main() -> None:
    """Check the named page, or all."""
    pages = [Path(word).resolve() for word in sys.argv[1:]] or PAGES
    programs = Path(sys.executable).parent
    os.environ["PATH"] = f"{programs}{os.pathsep}{os.environ['PATH']}"
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    with tempfile.TemporaryDirectory(prefix="fvs_commands_") as scratch:
        os.environ["ROS_LOG_DIR"] = f"{scratch}/log"
        for path in ROOT.iterdir():
            if path.name not in ("out", ".git"):
                (Path(scratch) / path.name).symlink_to(path)
        runner = _Runner(Path(scratch))
        try:
            bad = sum(check(page, runner) for page in pages)
        finally:
            runner.stop()
            (ROOT / "out").mkdir(exist_ok=True)
            shutil.copy(Path(scratch) / "commands.log", ROOT / "out")
    print("exit code, seconds, command; what was printed is in out/commands.log")
    if bad:
        raise RuntimeError(f"{bad} commands did not end well")
