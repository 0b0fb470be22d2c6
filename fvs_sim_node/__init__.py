"""An arm in PyBullet with a depth camera: the simulated side of the topics."""
