"""What the pages say of the code is so: files, sentences, commands, links."""

import re
from pathlib import Path

import pytest

from fvs_controller_node.reasons import Reason
from fvs_lab.report import EXPERIMENTS
from fvs_tools.scenario import NODE_TABLE

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md")])
#: Sentences that are no reason's own, and where they stand.
_ELSEWHERE = {
    "image stamps are too": "fvs_estimator_node/loop.py",
    "the camera seems to have been moved": "fvs_estimator_node/camera_doubts.py",
    "is taken; stop what is served there": "fvs_dashboard/page.py",
    "Reset everything": "fvs_dashboard/panel.py",
    "the camera's place is not known yet": "fvs_dashboard/placement.py",
    "this page gets too little of the processor": "fvs_dashboard/dashboard_node.py",
    "no picture: no node publishes": "fvs_dashboard/dashboard_node.py",
    "waiting for the first picture from": "fvs_dashboard/dashboard_node.py",
    "changes only while": "fvs_controller_node/node.py",
    "No word from this page's program": "fvs_dashboard/markup.py",
    "is not used: it contradicts the Jacobian": "fvs_controller_node/loop.py",
    "no robot_program_running yet": "fvs_controller_node/node.py",
    "target refused:": "fvs_controller_node/supervisor.py",
    "the newest ball_position is stamped": "fvs_controller_node/predictor.py",
    "The bag was cut off": "fvs_lab/replay/happened.py",
}
_NAMES = ("joint_states", "ball_position", "jacobian", "…")
_PARAMETERS = {p.name for entry in NODE_TABLE.values() for p in entry.parameters()}


def page(path):
    return path.read_text(encoding="utf-8")


def anchors(path):
    """The anchors that a page's headings get."""
    headings = re.findall(r"^#+ (.+)$", page(path), re.MULTILINE)
    plain = [re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings]
    return {heading.replace(" ", "-") for heading in plain}


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_links_lead_somewhere(path):
    for target in re.findall(r"\]\(([^)\s]+)\)", page(path)):
        if target.startswith("http"):
            continue
        file, _, anchor = target.partition("#")
        linked = path if not file else (path.parent / file).resolve()
        assert linked.exists(), target
        if anchor and linked.suffix == ".md":
            assert anchor in anchors(linked), target


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_named_files_exist(path):
    for name in re.findall(
        r"`((?:fvs_\w+/|test/|config/|docs/|bench/|launch/)[\w/]*\.\w+)", page(path)
    ):
        assert (ROOT / name).exists(), name


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_parameters_that_commands_set_exist(path):
    for name in re.findall(r"-p (?:\w+:)?([\w.]+):=", page(path)):
        assert name in {*_PARAMETERS, "name"}, name


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_experiments_that_commands_name_exist(path):
    for name in re.findall(r"(?:fvs_experiments |NAME=)(\w+)", page(path)):
        assert name in {*EXPERIMENTS, "all", "replay"}, name


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_a_status_is_shown_at_full_length(path):
    """``ros2 topic echo`` cuts strings at 128 characters."""
    commands = re.findall(r"ros2 topic echo (?:.*\\\n)?.*/status", page(path))
    assert all("--full-length" in command for command in commands)


def test_quoted_sentences_are_said():
    text = page(ROOT / "docs" / "troubleshooting.md")
    quotes = re.findall(r'"([^"]+)"', re.sub(r"```.*?```", "", text, flags=re.DOTALL))
    assert len(quotes) > 15
    said = {_filled(one.text, name) for one in Reason for name in _NAMES}
    for quote in quotes:
        if quote in _ELSEWHERE:
            assert quote in page(ROOT / _ELSEWHERE[quote])
        else:
            assert any(sentence.startswith(quote) for sentence in said), quote


def _filled(sentence, name):
    """A sentence with a name where one stands, and an ellipsis for every number."""
    return re.sub(r"\{.*?\}", "…", sentence.replace("{name}", name))
