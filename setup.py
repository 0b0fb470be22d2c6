"""Package of the nodes, for pip and for colcon; package.xml holds the same version.

The lower bound of a requirement is the oldest version meant to work, the upper bound the first
major version unknown.
"""

import os
import re
from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "fvs_ros"
URL = "https://github.com/fvs-ros/fvs_ros"

#: Jazzy or Kilted, by `make ROS=kilted`. Plain ros-rclpy and its like would resolve to the newest.
DISTRO = os.environ.get("FVS_ROS_DISTRO", "jazzy")
ROS = [
    f"ros-{DISTRO}-rclpy>=7.1.5,<10",
    f"ros-{DISTRO}-rmw-fastrtps-cpp>=8.4.2,<10",
    f"ros-{DISTRO}-common-interfaces>=5.3.5,<6",
    "jinja2>=3.1,<4",
]
# OpenCV 5.0 lacks the hand-eye solvers that the calibration is compared with.
CAMERA = ["opencv-python-headless>=4.8,<5"]
FIGURES = ["jinja2>=3.1,<4", "matplotlib>=3.8,<4"]
EXTRAS = {
    "ros": ROS,
    "camera": CAMERA,
    "sim": [
        *ROS,
        *CAMERA,
        *FIGURES,
        # From Python 3.12 on it has no wheels; a fork has, equal to the bit, but 2.5 times slower
        # in drawing whole images.
        "pybullet>=3.2.6,<4; python_version < '3.12'",
        "pybullet-arm64>=3.2.8,<4; python_version >= '3.12'",
    ],
    # The newest torch known to work; without an upper bound pip takes whatever is newest, and its
    # gigabytes of CUDA packages with it.
    "train": ["torch>=2.4,<=2.13.0"],
    "lab": [*FIGURES, "joblib>=1.3,<2", "cmaes>=0.10,<1"],
    "record": ["rosbags>=0.11.9,<0.12"],
    "dashboard": [*CAMERA, "viser[urdf]>=1.1,<1.2", "yourdfpy>=0.0.58,<1"],
    "docs": ["pdoc>=14,<17"],
    "test": [
        "pytest>=7.4,<10",
        "pytest-timeout>=2.2,<3",
        "pytest-rerunfailures>=13,<17",
        "pytest-xdist>=3.5,<4",
        "coverage>=7.10,<8",
        "hypothesis>=6.98,<7",
        "filterpy>=1.4.5,<3",
        "mcap-ros2-support>=0.5.5,<1",
        "playwright>=1.48,<2",
        # Formatting changes between minor versions; .pre-commit-config.yaml names the same.
        "ruff>=0.17.5,<0.18",
        "mypy>=2.4,<3",
        "types-PyYAML>=6.0.12,<7",
        "types-tqdm>=4.66,<5",
    ],
}
EXTRAS["all"] = sorted({one for name, extra in EXTRAS.items() if name != "docs" for one in extra})


def description():
    """README.md, its links made absolute: package indices show it alone."""
    text = (Path(__file__).resolve().parent / "README.md").read_text(encoding="utf-8")
    text = re.sub(r"(!\[[^]]*\]\()(?!http)", rf"\1{URL}/raw/main/", text)
    return re.sub(r"((?<!!)\[[^]]*\]\()(?!http|#)", rf"\1{URL}/blob/main/", text)


setup(
    name=PACKAGE,
    version="1.0.0",
    description="Uncalibrated visual servoing of a robot arm: learned Jacobian, "
    "finite-time control, simulator",
    long_description=description(),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    url=URL,
    project_urls={
        "Changelog": f"{URL}/blob/main/CHANGELOG.rst",
        "Issues": f"{URL}/issues",
    },
    classifiers=[
        "Development Status :: 4 - Beta",
        "Environment :: Console",
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3",
        "Topic :: Scientific/Engineering",
    ],
    keywords="ROS visual-servoing robotics calibration control",
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
    install_requires=[
        "numpy>=1.26,<3",
        # From 1.12 to 1.15 its nnls returns what is not the least, without a word
        # (https://github.com/scipy/scipy/issues/25389).
        "scipy>=1.11,!=1.12.*,!=1.13.*,!=1.14.*,!=1.15.*,<2",
        "threadpoolctl>=3.1,<4",
        "PyYAML>=6.0.1,<7",
        "tqdm>=4.66,<5",
    ],
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
            "fvs_target=fvs_tools.client_node:target",
            "fvs_launch=fvs_tools.launcher:main",
            "fvs_experiments=fvs_lab.main:main",
        ],
    },
)
