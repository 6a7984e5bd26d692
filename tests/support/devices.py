"""Robots with devices that are not drives beside robby's two: bus.yml, description and controllers for them."""

from __future__ import annotations

import json

import yaml
from support.robots import LEFT, RIGHT, Bench, copy_robby, dictionary_of
from support.virtualbench import Bench as NodeBench

from canopen_control.data_files import data_path
from canopen_control.virtual.device import make_device

IO = 5
_ANCHOR = '    <xacro:drive side="right"/>\n'
OUTPUTS = """
{name}:
  ros__parameters:
    joint: {part}
    interface_names: [{interfaces}]
    command_timeout: 0.0
"""


def with_device(folder, eds, part, *, commands=(), keys=None, name="io", tag="gpio", parameters="", node_id=IO):
    """Copy robby with one device: its node `name` in bus.yml, a <gpio> or <sensor> with the states of `part`.

    A controller `outputs` commands `commands`, a broadcaster `inputs` tells all.
    """
    config = copy_robby(folder)
    path = config / "bus.yml"
    bus = yaml.safe_load(path.read_text())
    defaults = bus.pop("defaults")
    bus["nodes"] = {name: {**defaults, **node} for name, node in bus["nodes"].items()}
    bus["nodes"][name] = {"dcf": eds, "node_id": node_id, "heartbeat_multiplier": 5, **(keys or {})}
    path.write_text(yaml.safe_dump(bus))
    states = "".join(f'<state_interface name="{name}"/>' for name in part)
    states += "".join(f'<command_interface name="{command}"/>' for command in commands)
    description = config / "robby.urdf.xacro"
    text = description.read_text().replace(_ANCHOR, f'{_ANCHOR}<{tag} name="{name}">{parameters}{states}</{tag}>\n')
    description.write_text(text)
    control = config / "ros2_controllers.yaml"
    loaded = "    inputs:\n      type: canopen_control/GpioBroadcaster\n\n"
    own = f"\ninputs:\n  ros__parameters:\n    joints: [{name}]\n    interfaces: {json.dumps(part)}\n"
    if commands:
        loaded += "    outputs:\n      type: forward_command_controller/MultiInterfaceForwardCommandController\n\n"
        own += OUTPUTS.format(name="outputs", part=name, interfaces=", ".join(commands))
    anchor = "    robby_forward_controller:\n"
    control.write_text(control.read_text().replace(anchor, loaded + anchor, 1) + own)
    return config


def with_measured_joint(folder):
    """Copy robby with an encoder that measures a joint of an arm, `arm_joint`."""
    config = with_device(folder, "generic_cia406.eds", ("position", "velocity"), name="encoder")
    description = config / "robby.urdf.xacro"
    text = description.read_text().replace('<gpio name="encoder">', '<joint name="arm_joint">ENCODER')
    text = text.replace("</gpio>", "</joint>").replace("ENCODER", '<param name="device_name">encoder</param>')
    arm = '<link name="arm"/><joint name="arm_joint" type="continuous">'
    arm += '<parent link="base_link"/><child link="arm"/></joint>'
    description.write_text(text.replace("</robot>", f"{arm}</robot>"))
    control = config / "ros2_controllers.yaml"
    control.write_text(control.read_text().replace("joints: [encoder]", "joints: [arm_joint]"))
    return config


class DeviceBench(Bench):
    """Robby with a device on the memory bus; `device` is the virtual one."""

    def __init__(self, name, config, *, node_id=IO, controllers=("robby_forward_controller",), **how):
        self.device_id = node_id
        super().__init__(name, config=config, drives=(LEFT, RIGHT, node_id), controllers=list(controllers), **how)

    @property
    def device(self):
        return self.drives[self.device_id]

    def set(self, **values):
        """Set inputs of the virtual device."""
        now = self.reactor.now()
        self.device.tick(now)
        self.device.function.set_signals(values, now)
        self.hosts[self.device_id].wake(self.device)

    def state(self, name):
        return self.robot.registry.state(name).value

    def terminal(self, name):
        """What the virtual device has at a terminal, past the bus."""
        return next(interface.value for interface in self.device.function.describe() if interface.name == name)


def virtual(number):
    """Return the bundled device of a profile on a bench of its own, booted."""
    return NodeBench(make_device(dictionary_of(data_path("eds", f"generic_cia{number}.eds")), IO)).on(0.1)


def put(bench, **values):
    """Set inputs of a device on a bench, and return the frames it sends for that."""
    bench.node.function.set_signals(values, bench.now)
    bench.node.send_changes(bench.now)
    return bench.collect()
