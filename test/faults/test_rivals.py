"""Two nodes that command one arm: the controller notices, holds, and says who it is."""

import numpy as np
import pytest
from std_msgs.msg import Float64MultiArray
from test_controller_faults import MODULE, Bench

from fvs_ros.core import ros


@pytest.fixture
def bench(ros_test):
    return Bench(ros_test)


def test_another_nodes_commands_hold_the_arm_and_the_node_is_named(bench):
    bench.servo()
    rival = bench.harness.node.create_publisher(Float64MultiArray, ros.COMMANDS, ros.QOS_RELIABLE)
    timer = bench.harness.node.create_timer(
        0.02, lambda: rival.publish(ros.to_command(np.full(6, 0.01)))
    )
    bench.wait(lambda: bench.reason() == "RIVAL", what="RIVAL")
    assert "/test_node commands the arm as well" in bench.text()
    timer.cancel()
    bench.harness.node.destroy_publisher(rival)
    bench.wait(lambda: "publishes commands as well" not in bench.text(), what="it to be gone")
    bench.assert_keeps_sending_zeros()


def test_a_second_controller_of_the_same_name_is_noticed(bench):
    bench.harness.start_node(MODULE)
    bench.wait(
        lambda: any("another /fvs_controller_node" in m.message for m in bench.statuses[-20:]),
        what="a word on the other one",
    )
