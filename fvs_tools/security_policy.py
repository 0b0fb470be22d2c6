"""The SROS2 policy of the nodes: who may publish, hear and serve what, from ``topics.py``."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable

from fvs_ros import topics
from fvs_ros.topics import CAMERA_PREFIXES, NODES

#: The enclave for a person's tools (``ros2 topic``, ``ros2 param``, RViz): sees everything, sets
#: parameters and targets, calls services, and cannot send a joint command.
OPERATOR = "fvs_operator"

_VERSION = "0.2.0"

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
    everything, services = set(topics.EVERY_NODE_PUBLISHES), set()
    for name, node in NODES.items():
        published = {topic.name for topic in topics.publishers(name)}
        heard = {topic.name for topic in topics.subscribers(name)}
        if node.hears_all:
            heard.add("/*")
        served = {*node.serves, *topics.EVERY_NODE_SERVES}
        _enclave(enclaves, name, namespace, published, heard, served, node.calls)
        everything |= {one.replace("~", name, 1) for one in published}
        services |= {one.replace("~", name, 1) for one in served}
    _enclave(enclaves, OPERATOR, namespace, {topics.TARGET_POSITION.name}, everything, (), services)
    ET.indent(root)
    where = f" in namespace /{namespace}" if namespace else ""
    holds = f"namespace /{namespace}" if namespace else "the root namespace"
    head = _HEAD.format(where=where, holds=holds)
    return head + ET.tostring(root, encoding="unicode") + "\n"


def _enclave(
    enclaves: ET.Element,
    node: str,
    namespace: str,
    published: Iterable[str],
    heard: Iterable[str],
    served: Iterable[str],
    called: Iterable[str],
) -> None:
    """Add the rules of one node."""
    enclave = ET.SubElement(enclaves, "enclave", path=topics.resolve("~", node, namespace))
    profiles = ET.SubElement(enclave, "profiles")
    profile = ET.SubElement(profiles, "profile", ns=f"/{namespace}", node=node)
    declared, *others = CAMERA_PREFIXES  # a camera is looked for under each
    cameras = [name.partition("/")[2] for name in heard if name.startswith(f"{declared}/")]
    heard = {*heard, *(f"{other}/{name}" for other in others for name in cameras)}
    for kind, verb, names in (
        ("topic", "publish", {*published, *topics.EVERY_NODE_PUBLISHES}),
        ("topic", "subscribe", {*heard, *topics.EVERY_NODE_SUBSCRIBES}),
        ("service", "reply", served),
        ("service", "request", called),
    ):
        if names:
            rules = ET.SubElement(profile, f"{kind}s", {verb: "ALLOW"})
            for name in sorted(names):
                ET.SubElement(rules, kind).text = name
