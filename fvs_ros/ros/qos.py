"""Quality of service of every topic; by default, the newest samples, reliable and volatile."""

from __future__ import annotations

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from fvs_ros.topics import Qos

#: Any publisher is compatible with it, and the newest sample wins.
QOS_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
QOS_RELIABLE = QoSProfile(depth=1)
QOS_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: Profile of each declared quality.
PROFILES = {Qos.NEWEST: QOS_NEWEST, Qos.RELIABLE: QOS_RELIABLE, Qos.LATCHED: QOS_LATCHED}
#: Reaches every node that is present, and none that starts later.
QOS_EVENT = QoSProfile(
    depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL, lifespan=Duration(seconds=1.0)
)
#: For recordings: a recorder that is busy for a moment loses nothing.
QOS_EVERY = QoSProfile(depth=25)
#: For images: one may still be in transit when the next is published.
QOS_LARGE = QoSProfile(depth=5)
