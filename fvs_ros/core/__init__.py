"""Pure building blocks shared by the nodes; only :mod:`fvs_ros.core.ros` knows ROS."""
