"""PyBullet UR5 with a depth camera: the simulated side of the topics."""
