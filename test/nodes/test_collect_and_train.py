"""From nothing to a model: simulator, collector and trainer as a user runs them."""

import os
import signal

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from harness import children
from recordings import relative_error
from std_msgs.msg import Float64MultiArray

from fvs_estimator_node.files import load_data_set, load_model
from fvs_ros import ros, topics
from fvs_sim_node.robot import HOME_JOINTS_RAD
from fvs_sim_node.simulation import SimConfig, Simulation

LAUNCHER = "fvs_tools.launcher"


def test_collecting_ends_when_the_arm_is_known_and_training_finds_its_jacobian(ros_test):
    data_path, model_path = ros_test.folder / "data.npz", ros_test.folder / "model.npz"
    given = {
        "output_path": data_path,
        # Fewer exchanges for a simulated second than a UR's.
        "joint_state_rate_hz": 50,
        "stop_at_error": 0.004,
    }
    arguments = (word for name in given for word in ("-p", f"{name}:={given[name]}"))
    process = ros_test.start(LAUNCHER, "collect_minute", *arguments)
    assert ros_test.wait(process, 80.0) == 0, ros_test.output(process)
    data = load_data_set(data_path)
    assert 5.0 < data.stamps_s[-1] - data.stamps_s[0] < 60.0
    assert data.provenance["ended"].startswith("finished: Jacobian known to 0.")
    known = data.provenance["known"]
    assert known["jacobian_deviation"] < 0.004
    assert known["misfit"] < 1.3
    home = np.array(HOME_JOINTS_RAD)
    assert np.abs(data.joints_rad[-1] - home).max() < 0.1
    assert np.all(np.abs(data.joints_rad - home) < np.array([0.6, 0.5, 0.5, 0.5, 0.5, 0.5]) + 0.03)
    speeds = np.diff(data.joints_rad, axis=0) / np.diff(data.stamps_s)[:, None]
    assert np.abs(speeds[np.diff(data.segment) == 0]).max() < 0.7

    train = ros_test.start(
        "fvs_tools.train", str(data_path), "-o", str(model_path), "--method", "poe"
    )
    assert ros_test.wait(train, 60.0) == 0, ros_test.output(train)
    trained = load_model(model_path)
    rng = np.random.default_rng(0)
    places = home + rng.uniform(-0.4, 0.4, (50, 6))
    with Simulation(SimConfig()) as simulation:
        true = np.array([simulation.true_jacobian(joints) for joints in places])
    assert np.median(relative_error(trained.chain.jacobian(places), true)) < 0.01
    assert np.median(relative_error(trained.model.jacobian(places), true)) < 0.03


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
