"""How do I teach a grasp and repeat it wherever the object is?

A tag on the tool and a tag on the object, before one camera. `teach` keeps where the tool is, seen
from the object; as a target it follows the object.
"""

from dataclasses import replace

from fvs_ros import ClosedLoop, SimConfig, Simulation

config = SimConfig(feature="pose", object_tag_id=10, rendered=False, position_noise_m=0.0003)
simulation = Simulation(config)
loop = ClosedLoop.of_scheme("best", simulation)
loop.run(1.2)  # at rest, as if somebody had put it there by hand


def relation():
    """The tool's true pose in the object's frame: position, m, and axes, (12,)."""
    return loop.kind.relative(loop.true_feature, simulation.true_object())


taught, wanted = loop.teach(), relation()
print(f"taught in the frame {taught.frame}: {loop.kind.text(taught.z)}")

for place_m, turned_deg in (((0.5, 0.0, 0.05), (75, 40, 40)), ((0.45, -0.15, 0.1), (70, 45, 20))):
    config = replace(config, object_position_m=place_m, object_rotation_deg=turned_deg)
    simulation.configure(config)
    simulation.place_object()
    loop.run(0.5)
    loop.set_target(taught)
    loop.run(3.0)
    error = loop.kind.minus(relation(), wanted)
    print(f"{loop.status.text}; true: {loop.kind.error_text(error)}")
simulation.close()
