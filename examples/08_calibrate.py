"""How do I find the camera in the robot's frame?

Servoing needs no calibration. Motion or still poses and the arm's URDF give it anyway, with its
standard deviation: here forty still poses of a tag, seen with 0.3 mm of noise.
"""

import numpy as np

from fvs_estimator_node.files import DataSet
from fvs_ros import SimConfig, Simulation
from fvs_ros.paths import find_file
from fvs_ros.urdf import read_joints
from fvs_tools.calibration import calibrate, report
from fvs_tools.kinematics import kinematics

rng, joints, tags = np.random.default_rng(1), list[np.ndarray](), list[np.ndarray]()
with Simulation(SimConfig(feature="pose", rendered=False, position_noise_m=0.0003)) as simulation:
    home_rad, camera, names = simulation.joints_rad, simulation.camera, simulation.world.joint_names
    while len(joints) < 40:
        pose_rad = home_rad + rng.uniform(-0.5, 0.5, 6)
        simulation.reset(pose_rad, seed=len(joints))
        tag = simulation.look().z
        if tag is not None:  # in view
            joints.append(pose_rad)
            tags.append(tag)

numbers = np.arange(40)
data = DataSet(
    1.0 * numbers, np.array(joints), np.array(tags), numbers, names, feature="pose", still=True
)
arm = kinematics(read_joints(find_file("robots/ur5.urdf").read_bytes()))
estimate = calibrate(data, arm)
print(report(estimate))
error_mm = 1e3 * np.linalg.norm(estimate.base_from_camera[:3, 3] - camera.position_m)
print(f"true error of the camera's position: {error_mm:.2f} mm")
