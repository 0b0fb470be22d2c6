"""The collector as a user runs it."""

import signal

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Float64MultiArray

from fvs_ros import ros, topics


def test_ctrl_c_leaves_zeros(ros_test):
    simulated = {"joint_state_rate_hz": 50, "simulated_time": True}
    ros_test.start_node("fvs_sim_node.node", **simulated)
    commands = ros_test.collect(Float64MultiArray, topics.COMMANDS.name, ros.QOS_EVERY)
    statuses = ros_test.collect(DiagnosticStatus, "fvs_collector_node/status")
    collector = ros_test.start_node(
        "fvs_estimator_node.collector_node",
        output_path=str(ros_test.folder / "part.npz"),
        joint_range_rad=0.3,  # all in view
        use_sim_time=True,
    )
    ros_test.spin_until(lambda: statuses and "MOVING" in str(statuses[-1]), 60.0)
    ros_test.spin_for(1.0)
    assert np.any([m.data for m in commands[-3:]])
    assert ros_test.stop(collector, signal.SIGINT) == 0
    ros_test.spin_for(0.2)
    assert not np.any([m.data for m in commands[-3:]])
