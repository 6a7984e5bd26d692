"""Axes of a physics world under movers of their own, in simulated time: no node, no bus, no sleep."""

import functools
import hashlib

from canopen_control.data_files import data_path
from canopen_control.physics.engine import make
from canopen_control.urdf.description import read_description
from canopen_control.virtual.axis_motion import AxisMotion
from canopen_control.virtual.trajectory import hold, ramp_to

MS, S = 1_000_000, 1_000_000_000
START = 1000 * S + 1_234_567  # not on the grid of any period
ROBBY = """
engine: mujoco
urdf: {urdf}
axes:
  "3": {{joint: left_wheel_joint, scale_pos_to_dev: -254.64790894703253}}
  "2": {{joint: right_wheel_joint, scale_pos_to_dev: 254.64790894703253}}
"""
BRAKED = """
<robot name="pendulum">
  <link name="base"/>
  <joint name="swing" type="revolute">
    <parent link="base"/><child link="rod"/><origin xyz="0 0 2"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="40" velocity="5"/>
  </joint>
  <link name="rod">
    <inertial><origin xyz="0.3 0 0"/><mass value="2"/>
      <inertia ixx="0.01" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
</robot>
"""


@functools.cache
def robby_urdf():
    return read_description(data_path("config", "robby/robby.urdf.xacro")).urdf_xml


class Owner:
    """The drive of an axis, which notes what it judges."""

    def __init__(self):
        self.errors, self.loads = [], []

    def arrived(self, now):
        pass

    def check_following_error(self, error, now):
        self.errors.append((now, error))

    def check_load(self, torque, now):
        self.loads.append((now, torque))

    def wants_samples(self):
        return False

    def next_index(self, demand, now):
        return None


class Axes:
    """All axes of a world; `look` is how they are brought on, in order, one after the other."""

    def __init__(self, world, *addresses):
        self.world, self.now = world, START
        self.movers = {address: AxisMotion(world.plant(*address), Owner()) for address in addresses}
        for mover in self.movers.values():
            mover.advance(self.now)

    def __getitem__(self, node):
        return self.movers[node, 0]

    def enable(self):
        for mover in self.movers.values():
            mover.power(True, self.now)
        for mover in self.movers.values():
            mover.run(hold(self.now, mover.plant.position), self.now)

    def cruise(self, node, speed, ramp=2.0):
        """Let a joint turn at `speed` rad/s, or m/s, in the direction of the joint."""
        mover = self[node]
        scale = mover.plant._scale
        up = abs(ramp * scale)
        mover.run(ramp_to(self.now, *mover.state(self.now), speed * scale, up, up), self.now)

    def go(self, seconds, every=20 * MS, nodes=None):
        end = self.now + round(seconds * S)
        while self.now < end:
            self.now = min(end, self.now + every)
            for address in nodes or self.movers:
                self.movers[address].advance(self.now)

    def digest(self):
        """Return what the state of the whole world hashes to, bit by bit."""
        state = b"".join(values.tobytes() for values in (self.world.angles, self.world.speeds))
        return hashlib.sha256(state).hexdigest()


def world_of(folder, text, urdf=None):
    """Return the world of a plant file; `{urdf}` in it is the description given, or robby's."""
    source = folder / "robot.urdf"
    source.write_text(robby_urdf() if urdf is None else urdf)
    path = folder / "physics.yml"
    path.write_text(text.format(urdf=source))
    return make(path)


def robby(folder, text=ROBBY, urdf=None):
    return Axes(world_of(folder, text, urdf), (3, 0), (2, 0))


def pendulum(folder, **axis):
    more = "".join(f", {name}: {value}" for name, value in axis.items())
    text = f"engine: mujoco\nurdf: {{urdf}}\naxes:\n  '5': {{{{joint: swing, scale_pos_to_dev: 100000{more}}}}}\n"
    return Axes(world_of(folder, text, BRAKED), (5, 0))
