"""Every node's parameters through the standard services: listed, described, changed, refused."""

import re

import numpy as np
import pytest
from every_node import ALONE, start_alone, wait_until_up
from harness import Harness
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.parameter import Parameter as RosParameter
from rclpy.parameter import parameter_value_to_python

from fvs_tools.scenario import NODE_TABLE

#: A parameter that no node has.
UNKNOWN = "no_such_parameter"
#: What rclpy gives every node.
BUILT_IN = ("use_sim_time", "start_type_description_service")

TYPES = {bool: "BOOL", int: "INTEGER", float: "DOUBLE", str: "STRING"}

nodes = pytest.mark.parametrize("name", NODE_TABLE)


class Services:
    """The parameter services of one running node."""

    def __init__(self, harness, node):
        self.harness = harness
        self.node = node
        self.declared = {p.name: p for p in NODE_TABLE[node.name].parameters()}

    def _call(self, kind, name, **request):
        return self.harness.call(kind, self.node.resolve(f"~/{name}"), kind.Request(**request))

    def names(self):
        return set(self._call(ListParameters, "list_parameters").result.names)

    def describe(self, names):
        answer = self._call(DescribeParameters, "describe_parameters", names=list(names))
        return {descriptor.name: descriptor for descriptor in answer.descriptors}

    def get(self, names):
        names = list(names)
        answer = self._call(GetParameters, "get_parameters", names=names)
        values = [parameter_value_to_python(value) for value in answer.values]
        return dict(zip(names, values, strict=True))

    def set(self, values):
        """Each value by itself, as ``ros2 param set`` sends it; results by name."""
        messages = [RosParameter(name, value=v).to_parameter_msg() for name, v in values.items()]
        answer = self._call(SetParameters, "set_parameters", parameters=messages)
        return dict(zip(values, answer.results, strict=True))

    def ask(self, name, *parameters):
        """What the node answers to messages as they are."""
        kind = SetParametersAtomically if name.endswith("atomically") else SetParameters
        return self._call(kind, name, parameters=list(parameters))

    def live(self):
        return {name: p for name, p in self.declared.items() if p.live}


@pytest.fixture(scope="module")
def services(tmp_path_factory):
    """Every node once, all at the same time; their services by name."""
    harness = Harness(tmp_path_factory.mktemp("parameters"))
    try:
        started = [
            start_alone(harness, name, f"lone_{index}") for index, name in enumerate(NODE_TABLE)
        ]
        wait_until_up(harness, started)
        yield {node.name: Services(harness, node) for node in started}
    finally:
        harness.close()


def other(parameter):
    """Another allowed value of a parameter, near its default."""

    def one(value):
        if parameter.choices:
            return next(choice for choice in parameter.choices if choice != value)
        if parameter.kind is bool:
            return not value
        if parameter.kind is str:
            return f"{value}x"
        step = abs(value) / 100 or 0.01
        step = max(1, round(step)) if parameter.kind is int else step
        above = parameter.maximum is None or value + step <= parameter.maximum
        return value + step if above else value - step

    default = parameter.default
    return [one(value) for value in default] if parameter.is_list else one(default)


def outside(parameter):
    """Values that are not allowed."""
    found = []
    if parameter.minimum is not None:
        found.append(parameter.kind(parameter.minimum - 1))
    if parameter.maximum is not None:
        found.append(parameter.kind(parameter.maximum + 1))
    if parameter.kind is float:
        found.append(float("nan"))
    if parameter.is_list:
        found = [[value] * len(parameter.default) for value in found]
        if parameter.size is not None:
            found.append(parameter.default[:-1])
    if parameter.choices:
        found.append("nonsense")
    return found


def same(one, two):
    return np.array_equal(np.asarray(one), np.asarray(two))


def assert_refused(result, *words):
    assert not result.successful
    assert re.fullmatch(r"[\w'].{15,}", result.reason, re.S), f"no sentence: {result.reason!r}"
    for word in words:
        assert word in result.reason, f"{word!r} is not in {result.reason!r}"


@nodes
def test_every_parameter_describes_itself(services, name):
    service = services[name]
    descriptors = service.describe(service.declared)
    for parameter in service.declared.values():
        descriptor = descriptors[parameter.name]
        kind = TYPES[parameter.kind] + ("_ARRAY" if parameter.is_list else "")
        assert descriptor.type == RosParameter.Type[kind].value, parameter.name
        assert descriptor.description == parameter.description
        assert descriptor.additional_constraints == parameter.expected()
        assert descriptor.read_only is not parameter.live, parameter.name
        if parameter.is_list:
            continue
        ranges = {int: descriptor.integer_range, float: descriptor.floating_point_range}
        for allowed in ranges.get(parameter.kind, []):
            if parameter.minimum is not None:
                assert allowed.from_value == parameter.minimum, parameter.name
            if parameter.maximum is not None:
                assert allowed.to_value == parameter.maximum, parameter.name
        limited = parameter.minimum is not None or parameter.maximum is not None
        assert bool(ranges.get(parameter.kind)) is limited, parameter.name


@nodes
def test_every_parameter_is_listed_with_its_default_and_nothing_else(services, name):
    service = services[name]
    assert service.names() - set(BUILT_IN) == set(service.declared)
    values = service.get(service.declared)
    expected = {p.name: p.default for p in service.declared.values()} | ALONE.get(name, {})
    assert [n for n in expected if not same(values[n], expected[n])] == []


@nodes
def test_a_live_parameter_changes_and_reads_back(services, name):
    service = services[name]
    changed = {n: other(p) for n, p in service.live().items()}
    before = service.get(changed)
    for values in (changed, before):
        assert {n: r.reason for n, r in service.set(values).items() if not r.successful} == {}
        found = service.get(values)
        assert [n for n in values if not same(found[n], values[n])] == []


def wrong_type(parameter):
    return [1 if parameter.kind in (str, bool) else "one"]


@nodes
@pytest.mark.parametrize("wrong", [outside, wrong_type, other])
def test_a_wrong_value_is_refused_with_a_sentence_and_the_old_one_stays(services, name, wrong):
    service = services[name]
    live = service.live()
    if wrong is other:  # right values, of parameters that are not live
        cases = {n: [other(p)] for n, p in service.declared.items() if not p.live}
    else:
        cases = {n: wrong(p) for n, p in live.items()}
    before = service.get(cases)
    for round_ in range(max(map(len, cases.values()), default=0)):
        values = {n: values[round_] for n, values in cases.items() if len(values) > round_}
        for parameter, result in service.set(values).items():
            word = live[parameter].expected() if parameter in live else "at start only"
            assert_refused(result, parameter, word)
    found = service.get(cases)
    assert [n for n in cases if not same(found[n], before[n])] == []


@nodes
@pytest.mark.parametrize("called", [UNKNOWN, "use_sim_time", "declared", ""])
def test_a_malformed_request_is_refused_and_ends_nothing(services, name, called):
    service = services[name]
    called = next(iter(service.declared)) if called == "declared" else called
    for number in (0, *range(5, 12), 77, 255):  # the types of lists, none, and unknown ones
        odd = ParameterMessage(name=called, value=ParameterValue(type=number))
        assert not service.ask("set_parameters_atomically", odd).result.successful
        results = service.ask("set_parameters", odd, odd).results
        assert [result.successful for result in results] == [False, False], number
    assert service.names() - set(BUILT_IN) == set(service.declared)


@nodes
def test_a_request_that_is_too_large_is_refused_in_few_words(services, name):
    service = services[name]
    first = next(iter(service.declared))
    value = RosParameter(first, value=service.get([first])[first]).get_parameter_value()
    for names in ([first] * 1000, ["x" * 10**6]):
        many = [ParameterMessage(name=one, value=value) for one in names]
        for result in service.ask("set_parameters", *many).results:
            assert_refused(result, "too large")
            assert len(result.reason) < 200
        assert_refused(service.ask("set_parameters_atomically", *many).result, "too large")
    assert service.get(service.declared)
