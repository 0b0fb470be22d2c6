"""The launcher hands names and values on as they are: no shell ever reads them."""

import json
import os
from pathlib import Path

import pytest
import yaml

from fvs_tools import launcher, scenario

HOSTILE = [
    "; touch TRAP",
    "$(touch TRAP)",
    "a\ntouch TRAP\n",
    "--ros-args -p x:=1",
    "é☃",
]

#: Writes what it was started with, and ends.
NODE = """
import json, os, sys, pathlib
params = sys.argv[sys.argv.index("--params-file") + 1]
told = {"argv": sys.argv[1:], "params": pathlib.Path(params).read_text(encoding="utf-8")}
pathlib.Path(os.environ["TOLD"]).write_text(json.dumps(told))
"""


@pytest.fixture
def told(tmp_path, monkeypatch):
    """A node of the table that tells how it was started, in a folder of its own."""
    (tmp_path / "telling_node.py").write_text(NODE)
    monkeypatch.setenv("TOLD", str(tmp_path / "told.json"))
    monkeypatch.setenv(
        "PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    )
    entry = scenario.NodeEntry("telling_node", "fvs_tools.demo", task=True)
    monkeypatch.setitem(scenario.NODE_TABLE, "fvs_demo_node", entry)
    monkeypatch.setattr(launcher.stop, "RECEIVED", [])
    monkeypatch.chdir(tmp_path)
    return tmp_path / "told.json"


def trapped(folder):
    return [path for path in folder.rglob("*") if "TRAP" in path.name]


@pytest.mark.parametrize("text", HOSTILE)
def test_a_hostile_value_or_file_name_reaches_the_node_as_it_is(told, text, tmp_path):
    path = tmp_path / f"{text.replace('/', '_')}.yaml"
    path.write_text(yaml.safe_dump({"fvs_demo_node": {"ros__parameters": {"output_dir": text}}}))
    given = f"target_positions:={json.dumps(text)}"
    assert launcher.main([str(path), "-p", given]) == 0
    heard = json.loads(told.read_text())
    values = yaml.safe_load(heard["params"])["/**/fvs_demo_node"]["ros__parameters"]
    assert values == {"output_dir": text, "target_positions": text}
    assert heard["argv"][:2] == ["--ros-args", "--params-file"]
    assert len(heard["argv"]) == 3
    assert [found for found in trapped(tmp_path) if found != path] == []


@pytest.mark.parametrize("text", [*HOSTILE, "a b", "a/../b", "1a", "a//b", "a\0b"])
def test_a_hostile_name_is_refused(told, text, tmp_path):
    Path("some.yaml").write_text("fvs_demo_node: {ros__parameters: {}}\n")
    Path("node.yaml").write_text(yaml.safe_dump({text: {"ros__parameters": {}}}))
    Path("name.yaml").write_text(yaml.safe_dump({"fvs_demo_node": {"ros__parameters": {text: 1}}}))
    options = (f"--namespace={text}", f"--scheme={text}", f"--param={text}:=1")
    for arguments in (["node.yaml"], ["name.yaml"], *(["some.yaml", one] for one in options)):
        assert launcher.main(arguments) == 2
    assert not told.exists()
    assert not trapped(tmp_path)
