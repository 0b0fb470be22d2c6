"""Scenario files, and what a command line makes of them."""

import sys
from pathlib import Path

import pytest
import yaml
from cases import each
from hypothesis import given
from hypothesis import strategies as st
from strangers import FEW, unless_refused

from fvs_tools.scenario import load_scenario, params_yaml
from fvs_tools.schemes import BEYOND, SCHEMES

CONFIG = Path(__file__).resolve().parents[2] / "config"


@each("path", sorted(CONFIG.glob("*.yaml")))
def test_every_scenario_passes_its_declarations(path):
    assert load_scenario(path.stem) == load_scenario(str(path))


def test_overrides_go_to_the_nodes_that_have_the_parameter():
    values = load_scenario(
        "demo",
        ["method:=frozen", "law:=proportional", "fvs_sim_node:seed:=7", "model_path:=other.npz"],
    )
    assert values["fvs_estimator_node"]["method"] == "frozen"
    assert values["fvs_controller_node"]["law"] == "proportional"
    assert values["fvs_sim_node"]["seed"] == 7
    assert values["fvs_demo_node"]["model_path"] == "other.npz"
    assert values["fvs_estimator_node"]["model_path"] == "other.npz"


@each(
    ("name", "overrides", "scheme_name", "words"),
    [
        ("demo", ["law=mpc"], "", "not of the form name:=value"),
        ("demo", ["fvs_sim_node:law:=ftsm"], "", "unknown parameter 'law'"),
        ("demo", [], "pid", r"did you mean rbf\+pid\? known are proposed, rbf\+pid"),
        ("collect", [], "proposed", "needs fvs_estimator_node and fvs_controller_node, which coll"),
        (
            "calibrate",
            ["output_path:=a"],
            "",
            "of fvs_calibrate_node: write fvs_collector_node:outp",
        ),
        ("nowhere.yaml", [], "", r"no file nowhere\.yaml; looked in .*config"),
    ],
)
def test_a_wrong_command_line_is_refused_in_words(name, overrides, scheme_name, words):
    with pytest.raises(ValueError, match=words):
        load_scenario(name, overrides, scheme_name)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("- a\n- b\n", "must map node names"),
        ("fvs_sim_node: {ros__parameters: {}, more: 1}\n", "and nothing else"),
        ("some_node: {ros__parameters: {}}\n", "unknown node .* known are fvs_sim_node"),
        (
            "/**: {ros__parameters: {feature_frme: a}}\nfvs_sim_node: {ros__parameters: {}}\n",
            "no node has a parameter feature_frme",
        ),
    ],
)
def test_a_file_that_is_no_scenario_is_refused_in_words(tmp_path, text, words):
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(ValueError, match=words):
        load_scenario(str(path))


def test_wildcard_parameters_reach_every_node_and_the_file_holds_in_any_namespace():
    scenario = load_scenario("collect")
    assert all(values["use_sim_time"] for values in scenario.values())
    content = yaml.safe_load(params_yaml(scenario))
    assert set(content) == {"/**/fvs_sim_node", "/**/fvs_collector_node"}


@each("scheme", [*SCHEMES.values(), *BEYOND.values()])
def test_a_scheme_sets_method_and_law_and_an_override_wins(scheme):
    parameters = load_scenario("demo", scheme_name=scheme.name)
    assert parameters["fvs_estimator_node"]["method"] == scheme.method
    assert parameters["fvs_controller_node"]["law"] == scheme.law
    assert scheme.controller_values.items() <= parameters["fvs_controller_node"].items()
    other = load_scenario("demo", ["law:=mfac"], scheme.name)
    assert other["fvs_controller_node"]["law"] == "mfac"


@each("name", ["ur5_real", "ur5_real_collect"])
def test_a_scenario_for_a_real_robot_is_slow_and_starts_nothing_by_itself(name):
    scenario = load_scenario(name)
    assert "fvs_sim_node" not in scenario
    assert "fvs_detector_node" in scenario
    for node, values in scenario.items():
        assert values.get("max_joint_velocity_rad_s", 0.0) <= 0.15, node
        assert values.get("max_joint_acceleration_rad_s2", 0.0) <= 0.5, node
        assert not values.get("autostart", False)
        assert not values.get("use_sim_time", False)


# ---- from strangers ---------------------------------------------------------------------------


def scenario(tmp_path, content):
    content = content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass")
    return unless_refused(lambda path: load_scenario(str(path)), tmp_path / "some.yaml", content)


PLAIN = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**31), 2**31), st.floats(), st.text(max_size=20),
    st.dates(),
)  # fmt: skip
ANY_YAML = st.recursive(
    PLAIN,
    lambda inner: st.lists(inner, max_size=7) | st.dictionaries(PLAIN, inner, max_size=4),
    max_leaves=12,
)


@FEW
@given(content=st.binary(max_size=300) | ANY_YAML.map(yaml.safe_dump))
def test_any_bytes_and_any_yaml_are_a_scenario_or_refused(tmp_path, content):
    scenario(tmp_path, content)


@pytest.mark.parametrize(
    "tag", ["!!python/object/apply:os.mkdir ['{}']", "!!python/module:antigravity"]
)
def test_no_code_is_run(tmp_path, tag):
    trap = tmp_path / "trapped"
    value = tag.format(trap)
    assert scenario(tmp_path, f"fvs_sim_node: {{ros__parameters: {{seed: {value}}}}}") is None
    with pytest.raises(ValueError, match="law"):
        load_scenario("demo", [f"law:={value}"])
    assert not trap.exists()
    assert "antigravity" not in sys.modules


@each("text", ["&a [*a]", "%YAML 9.9\n---\n{}", "a: 1\n---\nb: 2\n", "[" * 20000, "1" * 400])
def test_odd_scenarios_are_refused(tmp_path, text):
    assert scenario(tmp_path, text) is None
    assert scenario(tmp_path, f"fvs_sim_node: {{ros__parameters: {{seed: {text}}}}}\n") is None
