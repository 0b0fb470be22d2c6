"""The recorder beside test publishers: nothing is lost, whatever ends it."""

import subprocess
import sys
from collections import Counter

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool, Float64, Float64MultiArray

from fvs_ros import ros
from fvs_ros.kinds.ball import Ball
from fvs_ros.topics import RECORDER as NAME

pytest.importorskip("rosbags")

from fvs_tools.bag_reader import open_bag

mcap = pytest.importorskip("mcap_ros2.reader")
RECORDER = "fvs_tools.recorder_node"
DEEP = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)


def declared_counts(folder):
    """Messages by topic, as the bag's metadata has them."""
    text = (folder / "metadata.yaml").read_text(encoding="utf-8")
    listed = yaml.safe_load(text)["rosbag2_bagfile_information"]["topics_with_message_count"]
    return Counter({t["topic_metadata"]["name"]: t["message_count"] for t in listed})


def read_back(folder):
    """All messages, decoded by a reader that is not ours."""
    (path,) = folder.glob("*.mcap")
    return list(mcap.read_ros2_messages(str(path)))


@pytest.fixture
def recorder(ros_test):
    """A recorder that is up, and its folder."""
    process = ros_test.start_node(RECORDER, bag_dir="bag")
    ros_test.spin_until(lambda: "recording into bag" in ros_test.output(process), what="recorder")
    return process, ros_test.folder / "bag"


def listened(ros_test, publisher):
    ros_test.spin_until(lambda: publisher.get_subscription_count() > 0, what="the recorder")


def test_every_message_is_recorded_once(ros_test, recorder):
    process, bag = recorder
    lossy = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
    latched = QoSProfile(
        depth=1,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )
    node = ros_test.node
    reliable = node.create_publisher(Float64, "reliable", DEEP)
    first = node.create_publisher(Bool, "both_kinds", latched)
    first.publish(Bool(data=True))  # before anybody listens
    listened(ros_test, reliable)
    listened(ros_test, first)
    second = node.create_publisher(Bool, "both_kinds", lossy)
    listened(ros_test, second)
    sliding = node.create_publisher(Float64MultiArray, "sliding_variable", DEEP)  # of a pose
    listened(ros_test, sliding)
    sliding.publish(Float64MultiArray(data=[0.1]))
    for number in range(800):  # far more quickly than any topic of ours
        reliable.publish(Float64(data=float(number)))
    for _ in range(5):
        first.publish(Bool(data=True))
        second.publish(Bool(data=False))
    for publisher in (reliable, first, sliding):  # a burst may need to be sent again
        assert publisher.wait_for_all_acked(Duration(seconds=10.0))
    assert ros_test.stop(process) == 0, ros_test.output(process)

    messages = read_back(bag)
    numbers = [m.ros_msg.data for m in messages if m.channel.topic == "/reliable"]
    assert numbers == [float(number) for number in range(800)]
    both = Counter(m.ros_msg.data for m in messages if m.channel.topic == "/both_kinds")
    assert both == {True: 6, False: 5}
    assert [m.ros_msg.data for m in messages if m.channel.topic == "/sliding_variable"] == [[0.1]]
    times = [m.log_time_ns for m in messages]
    assert times == sorted(times)


def test_what_came_before_the_recorder_was_killed_is_read(ros_test, recorder):
    process, bag = recorder
    status = ros_test.collect(DiagnosticStatus, f"{NAME}/status")
    ball = ros_test.node.create_publisher(PointStamped, Ball.topics.tool.name, DEEP)
    listened(ros_test, ball)
    for number in range(30):
        ball.publish(ros.to_feature(1.0 + number, "eye", Ball(), np.array([0.1, 0.2, 0.8])))
    begun = len(status)
    # Its own status, at 10 Hz, is recorded, too: a second later all that is in the file.
    ros_test.spin_until(lambda: len(status) > begun + 20, what="two seconds of its status")
    process.kill()
    ros_test.wait(process)
    assert not (bag / "metadata.yaml").exists()
    with open_bag(bag) as reader:
        assert reader.cut_off
        names = [connection.topic for connection, _, _ in reader.messages()]
        assert names.count("/ball_position") == 30


def test_a_full_disk_ends_the_recording_with_a_whole_bag(ros_test):
    limit = "import fvs_tools.recorder_node as r; r._LEAST_FREE_MB = 1e12; r.main()"
    process = subprocess.Popen(
        [sys.executable, "-c", limit, "--ros-args", "-p", "bag_dir:=bag"],
        cwd=ros_test.folder,
        env=ros_test.environment,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert "MB are left on the disk" in process.communicate(timeout=30)[1]
    bag = ros_test.folder / "bag"
    assert Counter(message.channel.topic for message in read_back(bag)) == declared_counts(bag)
