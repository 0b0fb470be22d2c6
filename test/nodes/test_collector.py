"""From nothing to a model: simulator, collector and trainer as a user runs them."""

import os
import signal

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from harness import children
from std_msgs.msg import Float64MultiArray

from fvs_ros import ros, topics


def test_a_killed_worker_neither_stops_nor_jerks_the_arm_and_ctrl_c_leaves_zeros(ros_test):
    simulated = {"joint_state_rate_hz": 50, "simulated_time": True}
    ros_test.start_node("fvs_sim_node.node", **simulated)
    commands = ros_test.collect(Float64MultiArray, topics.COMMANDS.name, ros.QOS_EVERY)
    statuses = ros_test.collect(DiagnosticStatus, "fvs_collector_node/status")
    collector = ros_test.start_node(
        "fvs_estimator_node.collector_node",
        output_path=str(ros_test.folder / "part.npz"),
        stop_at_error=1e-6,
        joint_range_rad=0.3,  # all in view
        use_sim_time=True,
    )
    ros_test.spin_until(lambda: children(collector.pid), 60.0)
    before, told = len(commands), len(statuses)
    for pid in children(collector.pid):
        os.kill(pid, signal.SIGKILL)
    ros_test.spin_until(lambda: "for the whole duration" in statuses[-1].message)
    ros_test.spin_for(1.0)
    assert {ros.from_status(status)["state"] for status in statuses[told:]} == {"MOVING"}
    sent = np.array([m.data for m in commands[before - 5 :]])
    assert len(sent) > 30
    assert np.abs(sent).max(axis=1).min() > 0.05
    assert np.abs(np.diff(sent, axis=0)).max() < 3.0 * 0.05 + 1e-9
    assert children(collector.pid) == []
    assert ros_test.stop(collector, signal.SIGINT) == 0
    ros_test.spin_for(0.2)
    assert not np.any([m.data for m in commands[-3:]])
