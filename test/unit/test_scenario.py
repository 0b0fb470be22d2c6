from pathlib import Path

import pytest
import yaml

from fvs_controller_node.registry import LAWS
from fvs_estimator_node.registry import ESTIMATORS
from fvs_tools.scenario import (
    NODE_TABLE,
    ScenarioError,
    checked_remap,
    enclave_arguments,
    load_scenario,
)
from fvs_tools.schemes import BEYOND, SCHEMES, scheme

CONFIG = Path(__file__).resolve().parents[2] / "config"


@pytest.mark.parametrize("path", sorted(CONFIG.glob("*.yaml")), ids=lambda p: p.stem)
def test_every_scenario_passes_its_declarations(path):
    scenario = load_scenario(str(path))
    assert scenario.nodes
    assert load_scenario(path.stem).parameters == scenario.parameters


def test_every_node_of_the_table_declares_its_parameters():
    for entry in NODE_TABLE.values():
        assert list(entry.parameters()), entry.executable
        for parameter in entry.parameters():
            assert parameter.description, f"{entry.executable} {parameter.name}"


def test_overrides_go_to_the_nodes_that_have_the_parameter():
    scenario = load_scenario("demo").with_overrides(
        ["method:=frozen", "law:=proportional", "fvs_sim_node:seed:=7", "model_path:=other.npz"]
    )
    values = scenario.parameters
    assert values["fvs_estimator_node"]["method"] == "frozen"
    assert values["fvs_controller_node"]["law"] == "proportional"
    assert values["fvs_sim_node"]["seed"] == 7
    assert values["fvs_demo_node"]["seed"] == 0
    assert values["fvs_demo_node"]["model_path"] == "other.npz"
    assert values["fvs_estimator_node"]["model_path"] == "other.npz"


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("law=mpc", "not of the form name:=value"),
        ("lwa:=mpc", "unknown parameter .*'lwa'; did you mean law[?] known are .*law, "),
        ("law:=nonsense", "fvs_controller_node .*law must be one of"),
        ("law:=ftsn", "one of .*; did you mean ftsm[?]"),
        ("fvs_sim_node:law:=ftsm", "unknown parameter 'law'"),
        ("fvs_smi_node:seed:=1", "unknown node .*; did you mean fvs_sim_node[?]"),
        ("latency_s:=-1.0", "latency_s must be number from 0 to 1"),
    ],
)
def test_a_wrong_override_is_refused_in_words(override, words):
    with pytest.raises(ScenarioError, match=words):
        load_scenario("demo").with_overrides([override])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("- a\n- b\n", "must map node names"),
        ("fvs_sim_node: 3\n", "must hold ros__parameters"),
        ("fvs_sim_node: {ros__parameters: {}, more: 1}\n", "and nothing else"),
        ("some_node: {ros__parameters: {}}\n", "unknown node .* known are fvs_sim_node"),
        ("{}\n", "names no node"),
        (
            "fvs_sim_node: {ros__parameters: {sead: 3}}\n",
            "unknown parameter 'sead'; did you mean seed[?]",
        ),
        ("a: [\n", "cannot read scenario"),
    ],
)
def test_a_file_that_is_no_scenario_is_refused_in_words(tmp_path, text, words):
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(ScenarioError, match=words):
        load_scenario(str(path))


def test_a_missing_scenario_says_where_it_was_looked_for():
    with pytest.raises(ScenarioError, match=r"no file nowhere\.yaml; looked in .*config"):
        load_scenario("nowhere.yaml")


def test_a_misspelled_scenario_is_answered_with_the_right_one_and_all():
    with pytest.raises(ScenarioError, match=r"did you mean demo\? known are .*, servo, ur5_real"):
        load_scenario("dmeo")


@pytest.mark.parametrize("content", [b"PK\x03\x04\xff", b"a: \x00"])
def test_a_binary_file_is_called_so(tmp_path, content):
    path = tmp_path / "model.npz"
    path.write_bytes(content)
    with pytest.raises(ScenarioError, match="it is binary, expected text"):
        load_scenario(str(path))


@pytest.mark.parametrize(
    ("scenario", "overrides", "missing"),
    [
        ("demo", [], ""),
        ("collect", [], ""),
        ("dashboard", [], ""),
        ("demo", ["model_path:=nowhere.npz"], "fvs_estimator_node needs a model: no file nowhere"),
        ("servo", ["model_path:=nowhere.npz", "method:=oracle"], ""),
        ("demo", ["fvs_demo_node:model_path:=nowhere.npz"], "fvs_demo_node needs a model"),
    ],
)
def test_a_missing_model_is_found_before_anything_starts(scenario, overrides, missing):
    wanted = load_scenario(scenario).with_overrides(overrides)
    if not missing:
        return wanted.check_models()
    with pytest.raises(ScenarioError, match=missing):
        wanted.check_models()


def test_wildcard_parameters_reach_every_node_and_the_file_holds_in_any_namespace():
    scenario = load_scenario("collect")
    assert all(values["use_sim_time"] for values in scenario.parameters.values())
    content = yaml.safe_load(scenario.to_params_yaml())
    assert set(content) == {"/**/fvs_sim_node", "/**/fvs_collector_node"}


@pytest.mark.parametrize("name", [*SCHEMES, *BEYOND])
def test_a_scheme_sets_method_and_law(name):
    one = scheme(name)
    assert one.name == name
    assert one.description.endswith(".")
    assert one.law in LAWS
    assert one.method in ESTIMATORS
    before, after = load_scenario("demo").parameters, load_scenario("demo").with_scheme(name)
    assert after.parameters["fvs_estimator_node"]["method"] == one.method
    assert after.parameters["fvs_controller_node"]["law"] == one.law
    controller = after.parameters["fvs_controller_node"]
    assert {name: controller[name] for name in one.controller_values} == one.controller_values
    assert after.parameters["fvs_demo_node"] == before["fvs_demo_node"]


def test_the_best_scenario_is_the_demo_with_the_best_scheme():
    wanted = load_scenario("demo").with_scheme("best").with_overrides(["output_dir:=out/best"])
    assert load_scenario("best").parameters == wanted.parameters


def test_an_override_wins_over_a_scheme():
    scenario = load_scenario("demo").with_scheme("rbf+pid").with_overrides(["law:=mfac"])
    assert scenario.parameters["fvs_controller_node"]["law"] == "mfac"
    assert scenario.parameters["fvs_estimator_node"]["method"] == "rbf"


def test_a_scheme_that_does_not_fit_is_refused_in_words():
    with pytest.raises(
        ScenarioError, match=r"did you mean rbf\+pid\? known are proposed, rbf\+pid"
    ):
        load_scenario("demo").with_scheme("pid")
    with pytest.raises(
        ScenarioError,
        match=r"needs fvs_estimator_node and fvs_controller_node, which collect\.yaml",
    ):
        load_scenario("collect").with_scheme("proposed")


@pytest.mark.parametrize(
    "rule", ["a:=b", "camera/color/image_raw:=/my/image", "~/status:=/s", "fvs_sim_node:a:=b"]
)
def test_a_remap_rule_passes(rule):
    assert checked_remap(rule) == rule


@pytest.mark.parametrize(
    "rule", ["a", "a:=", ":=b", "a:=b;c", "a:=$(id)", "-p:=x", "a:= b", "a:=b\n"]
)
def test_what_is_no_remap_rule_is_refused(rule):
    with pytest.raises(ScenarioError, match="not of the form"):
        checked_remap(rule)


def test_nodes_get_their_enclave_only_where_security_is_on():
    on = {"ROS_SECURITY_ENABLE": "true"}
    assert enclave_arguments("a_node", "", on) == ["--enclave", "/a_node"]
    assert enclave_arguments("a_node", "/left/arm", on) == ["--enclave", "/left/arm/a_node"]
    assert enclave_arguments("a_node", "left", {}) == []
    assert enclave_arguments("a_node", "left", {"ROS_SECURITY_ENABLE": "false"}) == []


@pytest.mark.parametrize("name", ["ur5_real", "ur5_real_collect"])
def test_a_scenario_for_a_real_robot_is_slow_and_starts_nothing_by_itself(name):
    scenario = load_scenario(name)
    assert "fvs_sim_node" not in scenario.nodes
    assert "fvs_detector_node" in scenario.nodes
    for node, values in scenario.parameters.items():
        assert values.get("max_joint_velocity_rad_s", 0.0) <= 0.15, node
        assert values.get("max_joint_acceleration_rad_s2", 0.0) <= 0.5, node
        assert not values.get("autostart", False)
        assert not values.get("use_sim_time", False)
