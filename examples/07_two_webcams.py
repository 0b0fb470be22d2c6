"""How do I servo with two webcams of which nothing is known?

Each shows the ball at a pixel. Two pixels fix a point in space, so the target is a pair of them:
where the ball was seen once. When one camera is covered, the other goes on.
"""

from dataclasses import replace

from fvs_ros import ClosedLoop, SimConfig, Simulation
from fvs_ros.kinds.points import Points

config = SimConfig(
    feature="points",
    points=Points(cameras=("front", "side")),
    image_rates_hz=(30.0, 20.0),
    latencies_s=(0.04, 0.07),
    rendered=False,
    position_noise_m=0.0015,  # 0.3 px
)
simulation = Simulation(config)
home_rad = simulation.joints_rad
simulation.reset(home_rad + [0.2, -0.1, 0.2, 0.1, -0.1, 0.0])
target_px = simulation.true_feature()
simulation.reset(home_rad)

loop = ClosedLoop.of_scheme("best", simulation)
loop.run(0.5)
print("seen at  ", loop.kind.text(loop.feature))
print("wanted at", loop.kind.text(target_px))
loop.set_target(target_px)
loop.run(0.15)
simulation.configure(replace(config, camera_covered=True, covered_cameras=("side",)))
loop.run(2.0)
print("seen at  ", loop.kind.text(loop.true_feature), "by the front camera alone")
print(loop.status.text)
simulation.close()
