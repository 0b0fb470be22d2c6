"""Quality of service of every topic of the package."""

from __future__ import annotations

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from fvs_ros.topics import Qos


def _qos(reliability: ReliabilityPolicy, durability: DurabilityPolicy) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=1, reliability=reliability, durability=durability
    )


#: Any publisher is compatible with it, and the newest sample wins.
QOS_NEWEST = _qos(ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE)
QOS_RELIABLE = _qos(ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)
QOS_LATCHED = _qos(ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)
#: Profile of each declared quality.
PROFILES = {Qos.NEWEST: QOS_NEWEST, Qos.RELIABLE: QOS_RELIABLE, Qos.LATCHED: QOS_LATCHED}
#: Reaches every node that is present, and none that starts later.
QOS_EVENT = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    lifespan=Duration(seconds=1.0),
)
#: For recordings: a recorder that is busy for a moment loses nothing.
QOS_EVERY = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=25, reliability=ReliabilityPolicy.RELIABLE
)
#: For images: one may still be in transit when the next is published.
QOS_LARGE = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=5, reliability=ReliabilityPolicy.RELIABLE
)
