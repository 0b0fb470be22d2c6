# A ROS 2 Jazzy workspace with the simulator. docker build -t fvs_ros . && docker run --rm fvs_ros
FROM ros:jazzy
WORKDIR /ws
COPY package.xml src/fvs_ros/
# RViz needs a display, and a gigabyte.
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3-pip \
    && rosdep update --rosdistro jazzy \
    && rosdep install --from-paths src --ignore-src --rosdistro jazzy --skip-keys rviz2 -y \
    && rm -rf /var/lib/apt/lists/*
# Tags need a newer OpenCV than apt has, and apt's NumPy no newer than this.
RUN pip install --no-cache-dir --break-system-packages pybullet-arm64 "opencv-python-headless<4.12"
COPY . src/fvs_ros
RUN . /opt/ros/jazzy/setup.sh && colcon build --symlink-install
CMD ["bash", "-c", "source install/setup.bash && ros2 launch fvs_ros fvs.launch.py scenario:=demo"]
