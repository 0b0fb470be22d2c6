"""Programs that compose the nodes' packages: launcher, demo, training."""
