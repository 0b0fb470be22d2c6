"""How do I servo with the camera on the arm?

The camera rides on the last link, and a tag stands in the room. The target is where the tag shall
be seen: here 5 cm further to the left, and nearer. The controller keeps the tag in view.
"""

import numpy as np

from fvs_ros import ClosedLoop, SimConfig, Simulation

config = SimConfig(feature="pose", camera_mount="arm", rendered=False, position_noise_m=0.0002)
simulation = Simulation(config)
loop = ClosedLoop.of_scheme("best", simulation)
loop.run(0.5)

motion_m = np.array([-0.05, 0.0, -0.05, 0.0, 0.0, 0.0])  # way, and rotation vector times lever arm
target = loop.kind.retract(loop.feature, motion_m)
loop.set_target(target)
loop.run(2.0)
print(loop.status.text)
print("true error:", loop.kind.error_text(loop.kind.minus(loop.true_feature, target)))
simulation.close()
