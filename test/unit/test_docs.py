"""What the pages say of the code is so: files, sentences, commands, links, and their length."""

import re
import shlex
from functools import cache
from importlib.metadata import EntryPoint
from itertools import pairwise
from pathlib import Path

import pytest
from cases import each

from bench.bench_commands import commands, launched
from fvs_controller_node.reasons import Reason
from fvs_ros import stop
from fvs_ros.arguments import Parser
from fvs_ros.topics import NODES
from fvs_tools import reference
from fvs_tools.scenario import load_scenario, parameters_of

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
DOCS = sorted((ROOT / "docs").glob("*.md"))
PAGES = [*sorted(ROOT.glob("*.md")), *DOCS]
GENERATED = {path.name for path in reference.pages()}
TROUBLES = ROOT / "docs" / "troubleshooting.md"
#: Reasons with which nothing is wrong.
FINE = {"SERVOING", "SETTLED"}

each_page = each("path", PAGES)


def page(path):
    return path.read_text(encoding="utf-8")


def anchors(path):
    """The anchors that a page's headings get."""
    headings = re.findall(r"^#+ (.+)$", page(path), re.MULTILINE)
    plain = [re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings]
    return {heading.replace(" ", "-") for heading in plain}


@cache
def source():
    """The package's code and templates, with string literals over several lines joined."""
    files = [*sorted(ROOT.glob("fvs_*/**/*.py")), *sorted(ROOT.glob("fvs_*/*.jinja"))]
    return re.sub(r"\"\s*\n\s*f?\"", "", "\n".join(map(page, files)))


@each_page
def test_links_lead_somewhere(path):
    for target in re.findall(r"\]\(([^)\s]+)\)", page(path)):
        if target.startswith("http"):
            continue
        file, _, anchor = target.partition("#")
        linked = path if not file else (path.parent / file).resolve()
        assert linked.exists(), target
        if anchor and linked.suffix == ".md":
            assert anchor in anchors(linked), target


@each_page
def test_named_files_exist(path):
    for name in re.findall(
        r"`((?:fvs_\w+/|test/|config/|docs/|bench/|launch/)[\w/]*\.\w+)", page(path)
    ):
        if not name.startswith("bench/bench_NAME"):
            assert (ROOT / name).exists(), name


class ParsedError(Exception):
    """Ends a program once its arguments are parsed."""


@each_page
def test_programs_take_the_arguments_of_commands(path, monkeypatch, tmp_path):
    def parse(parser, words=None, namespace=None):
        given, rest = parser.parse_known_args(words, namespace)
        raise ParsedError(given, rest)

    monkeypatch.setattr(Parser, "parse_args", parse)
    monkeypatch.setattr(stop, "listen", lambda: None)  # that of programs, when they are imported
    programs = dict(re.findall(r'"(fvs_\w+)=([\w.]+:\w+)"', (ROOT / "setup.py").read_text()))
    for command in commands(path):
        words = shlex.split(command)
        if scenario := launched(words):
            words = ["fvs_launch", *scenario]
        if words[0] in (*NODES, "fvs_servo_node"):
            known = {parameter.name for node in NODES for parameter in parameters_of(node)}
            named = {word.partition(":=")[0] for flag, word in pairwise(words) if flag == "-p"}
            assert named <= known, command
        elif words[0].startswith("fvs_"):
            monkeypatch.setattr("sys.argv", words)
            with pytest.raises(ParsedError) as parsed:
                EntryPoint(words[0], programs[words[0]], "console_scripts").load()()
            given, rest = parsed.value.args
            assert not rest, command
            if scenario:
                record = given.record and str(tmp_path / "bag")
                load_scenario(given.scenario, given.param, given.scheme, record)


def test_pages_write_commands_for_an_activated_environment():
    named = [name for path in DOCS for name in re.findall(r"\.venv/bin/(\w+)", page(path))]
    assert set(named) == {"activate"}


def test_every_reason_is_explained():
    named = set(re.findall(r"`(?!ROS_)([A-Z]{2,}(?:_[A-Z]+)*)`", page(TROUBLES)))
    assert named == {reason.name for reason in Reason} - FINE


def test_quoted_sentences_are_said():
    text = re.sub(r"```.*?```", "", page(TROUBLES), flags=re.DOTALL)
    quotes = re.findall(r'"([^"]+)"', text)
    assert len(quotes) > 10
    assert [quote for quote in quotes if quote not in source()] == []


def test_readers_in_a_hurry_get_through():
    assert len(page(README).split()) <= 900
    written = [path for path in DOCS if path.name not in GENERATED]
    assert sum(len(page(path).split()) for path in written) <= 13_000
    index = page(ROOT / "docs" / "index.md")
    assert [path.name for path in DOCS if path.name != "index.md" and path.name not in index] == []


# ---- the reference, which is generated ------------------------------------------------------


def test_the_committed_pages_are_what_would_be_written_now():
    # No long comparison: the remedy is the same whatever differs.
    stale = [path.name for path, text in reference.pages().items() if page(path) != text]
    assert not stale, f"run {reference.COMMAND}"


def test_no_parameter_of_a_node_passes_for_a_slip_of_anothers():
    for node in NODES:
        for other in NODES:
            slips = {p.name for p in parameters_of(other) if parameters_of(node).is_slip(p.name)}
            assert slips <= {"camera"}, f"{node}, {other}"  # the simulator's, near to cameras


def test_parameters_have_si_units_and_no_negative_time_rate_or_size():
    for node in NODES:
        for parameter in parameters_of(node):
            where, name = f"{node}: {parameter.name}", parameter.name
            assert not name.endswith(("_ms", "_mm", "_cm", "_us", "_ns")), where
            if name.endswith(("_s", "_hz", "radius_m", "error_m", "_rad_s2")):
                # Stamps may be early, and velocities have a direction.
                signed = name == "stamp_delay_s" or name.startswith("object_")
                assert (parameter.minimum or 0.0) >= 0.0 or signed, where
