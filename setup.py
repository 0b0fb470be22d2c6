"""Package of the nodes, for pip and for colcon; package.xml holds the same version."""

from glob import glob

from setuptools import find_packages, setup

PACKAGE = "fvs_ros"

EXTRAS = {
    "ros": [
        "ros-jazzy-rclpy",
        "ros-jazzy-rmw-fastrtps-cpp",
        "ros-jazzy-common-interfaces",
        "jinja2",
    ],
    "camera": ["opencv-python-headless"],
    "sim": ["pybullet", "opencv-python-headless", "matplotlib"],
    "train": ["torch"],
    "lab": ["joblib", "cmaes", "jinja2", "matplotlib"],
    "record": ["rosbags"],
    "dashboard": ["viser[urdf]>=1.1,<1.2", "opencv-python-headless"],
    "docs": ["pdoc"],
    "test": [
        "pytest",
        "pytest-timeout",
        "pytest-rerunfailures",
        "pytest-xdist",
        "coverage",
        "hypothesis",
        "filterpy",
        "mcap-ros2-support",
        "playwright",
        "ruff",
        "mypy",
        "types-PyYAML",
        "types-tqdm",
    ],
}
EXTRAS["all"] = [one for name, extra in EXTRAS.items() if name != "docs" for one in extra]

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Uncalibrated visual servoing of a robot arm: learned Jacobian, "
    "finite-time control, simulator",
    license="Apache-2.0",
    maintainer="fvs_ros maintainers",
    maintainer_email="maintainers@example.org",
    python_requires=">=3.10",
    packages=find_packages(include=["fvs_*"]),
    package_data={"fvs_lab": ["*.jinja"], "fvs_tools": ["*.jinja"], "fvs_dashboard": ["*.css"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (
            f"share/{PACKAGE}/config",
            [*sorted(glob("config/*.yaml")), "config/fvs.rviz", "config/quick_discovery.xml"],
        ),
        (f"share/{PACKAGE}/config/robots", sorted(glob("config/robots/*.urdf"))),
        (f"share/{PACKAGE}/config/models", sorted(glob("config/models/*.npz"))),
        (f"share/{PACKAGE}/launch", sorted(glob("launch/*.py"))),
    ],
    # What the cores need without ROS; in a ROS workspace rosdep brings these by apt.
    install_requires=["numpy", "scipy", "threadpoolctl", "PyYAML", "tqdm"],
    extras_require=EXTRAS,
    zip_safe=True,
    entry_points={
        "console_scripts": [
            "fvs_sim_node=fvs_sim_node.node:main",
            "fvs_detector_node=fvs_detector_node.node:main",
            "fvs_estimator_node=fvs_estimator_node.node:main",
            "fvs_controller_node=fvs_controller_node.node:main",
            "fvs_servo_node=fvs_tools.servo_node:main",
            "fvs_collector_node=fvs_estimator_node.collector_node:main",
            "fvs_demo_node=fvs_tools.demo_node:main",
            "fvs_calibrate_node=fvs_tools.calibrate_node:main",
            "fvs_recorder_node=fvs_tools.recorder_node:main",
            "fvs_dashboard=fvs_dashboard.dashboard_node:main",
            "fvs_calibrate=fvs_tools.calibrate:main",
            "fvs_train=fvs_tools.train:main",
            "fvs_tag=fvs_tools.tag:main",
            "fvs_servo=fvs_tools.client_node:main",
            "fvs_launch=fvs_tools.launcher:main",
            "fvs_experiments=fvs_lab.main:main",
        ],
    },
)
