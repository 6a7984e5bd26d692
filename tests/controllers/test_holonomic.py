from __future__ import annotations

from canopen_control.controllers.holonomic import HOLONOMIC, HolonomicBase
from canopen_control.controllers.planar_pose import HolonomicKinematics


def wheels_of_three():
    return HolonomicKinematics([(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)], 1.0)


class Base(HolonomicBase):
    def advance(self, dt: float) -> None:
        """Integrate nothing."""


def test_a_base_is_driven_by_the_wheels_that_move_its_pose():
    base = Base("base", "test/Base", wheels_of_three())
    wheels = wheels_of_three()
    base.move_by(wheels)
    base.targets = [0.0, 0.0, 0.0]
    base.compute_commands([1.0, 2.0, 4.0])
    assert base.targets == [1.0, 2.0, 4.0]
    wheels.forward, wheels.left, wheels.angular = 0.1, 0.2, 0.3
    assert base.velocities() == (0.1, 0.2, 0.3)
    assert base.pose is wheels
    assert (base.twist_axes, len(base.reference_interfaces())) == (HOLONOMIC, 3)
