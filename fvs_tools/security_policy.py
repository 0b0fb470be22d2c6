"""The SROS2 policy of the nodes: who may publish, hear and serve what, from ``topics.py``."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable

from fvs_ros import topics
from fvs_ros.topics import INTERFACES

#: The enclave for a person's tools (``ros2 topic``, ``ros2 param``, RViz): sees everything, sets
#: parameters and targets, calls services, and cannot send a joint command.
OPERATOR = "fvs_operator"

_VERSION = "0.2.0"
#: They look for a camera under several names.
_FIND_CAMERAS = ("fvs_detector_node", "fvs_dashboard")
#: Every name, in a rule.
_ANY = "/*"

# No "--" in it: XML does not allow it in a comment.
_HEAD = """\
<?xml version="1.0" encoding="UTF-8"?>
<!--
  Access rules of the nodes for SROS2{where}. Written by fvs_tools/reference.py from
  fvs_ros/topics.py; docs/reference.md says how to use it.

  One enclave a node, called like the node with its namespace, and one for a person's tools.
  What is not listed is denied: above all, only two nodes may publish joint commands.

  Names hold for {holds} and without remaps. Rules for another namespace:
      python3 -m fvs_tools.reference -p policy.xml -n NAMESPACE
  With a remap, change the name here too. A robot's driver, a camera and a detector of your own
  need enclaves of their own; their rules are not here.
-->
"""


def policy(namespace: str = "") -> str:
    """The policy as XML text.

    Parameters
    ----------
    namespace : str
        Namespace that the nodes are started in, with or without slashes at its ends.

    Returns
    -------
    str
        A policy file of schema 0.2.0.
    """
    namespace = namespace.strip("/")
    root = ET.Element("policy", version=_VERSION)
    enclaves = ET.SubElement(root, "enclaves")
    for node, interface in INTERFACES.items():
        profile = _profile(enclaves, node, namespace)
        published = [end.topic.name for end in interface.publishes]
        heard = [end.topic.name for end in interface.subscribes]
        if node in _FIND_CAMERAS:
            heard = _wherever_cameras_publish(heard)
        if interface.hears_all:
            heard.append(_ANY)
        served = [service.name for service in interface.serves]
        _allow(profile, "topic", "publish", [*published, *topics.EVERY_NODE_PUBLISHES])
        _allow(profile, "topic", "subscribe", [*heard, *topics.EVERY_NODE_SUBSCRIBES])
        _allow(profile, "service", "reply", [*served, *topics.EVERY_NODE_SERVES])
        if interface.calls:
            _allow(profile, "service", "request", interface.calls)
    _operator(enclaves, namespace)
    ET.indent(root)
    where = f" in namespace /{namespace}" if namespace else ""
    holds = f"namespace /{namespace}" if namespace else "the root namespace"
    head = _HEAD.format(where=where, holds=holds)
    return head + ET.tostring(root, encoding="unicode") + "\n"


def _operator(enclaves: ET.Element, namespace: str) -> None:
    every = topics.EVERY_NODE_PUBLISHES
    heard: list[str] = []
    called: list[str] = []
    for node, interface in INTERFACES.items():
        # Below a node's own name ("~/") for the node, below the node's name for others.
        heard += [end.topic.of(node).name for end in interface.publishes]
        served = [service.name for service in interface.serves]
        called += [name.replace("~", node, 1) for name in [*served, *topics.EVERY_NODE_SERVES]]
    profile = _profile(enclaves, OPERATOR, namespace)
    _allow(profile, "topic", "publish", [topics.TARGET_POSITION.name, *every])
    heard = _wherever_cameras_publish(heard)
    _allow(profile, "topic", "subscribe", [*heard, *every, *topics.EVERY_NODE_SUBSCRIBES])
    _allow(profile, "service", "request", called)


def _wherever_cameras_publish(names: Iterable[str]) -> list[str]:
    """The names, a camera's below every prefix that is looked at without being asked."""
    declared, *others = topics.CAMERA_PREFIXES
    found = []
    for name in names:
        found.append(name)
        if name.startswith(f"{declared}/"):
            found += [other + name.removeprefix(declared) for other in others]
    return found


def _profile(enclaves: ET.Element, node: str, namespace: str) -> ET.Element:
    enclave = ET.SubElement(enclaves, "enclave", path=topics.resolve("~", node, namespace))
    profiles = ET.SubElement(enclave, "profiles")
    return ET.SubElement(profiles, "profile", ns=f"/{namespace}", node=node)


def _allow(profile: ET.Element, kind: str, verb: str, names: Iterable[str]) -> None:
    rules = ET.SubElement(profile, f"{kind}s", {verb: "ALLOW"})
    for name in sorted(set(names)):
        ET.SubElement(rules, kind).text = name
