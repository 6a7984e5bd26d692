"""arm6 with a joint trajectory controller, also above loops of velocity or effort; its files are those of the bench."""

from canopen_control_bench.arm import ENDS, JOINTS, copy_arm, planned
from support.robots import PATIENT

__all__ = ["CYCLIC", "ENDS", "JOINTS", "LOOPS", "copy_arm", "copy_looped_arm", "copy_patient_arm", "planned"]

LOOPS = """
    loops:
      type: pid_controller/PidController

loops:
  ros__parameters:
    dof_names: [joint_1, joint_2, joint_3, joint_4, joint_5, joint_6]
    command_interface: KIND
    reference_and_state_interfaces: [position, velocity]
    enable_feedforward: true
    gains:
"""
CYCLIC = {"velocity": ("0x60FF", 9), "effort": ("0x6071", 10)}
"""Target object and mode of operation of what is commanded."""


def copy_patient_arm(folder):
    """Copy the arm with drives that bear a very busy machine; the bundled one loses them after 60 ms of silence."""
    target = copy_arm(folder)
    bus = target / "bus.yml"
    text = bus.read_text()
    for old, new in {**PATIENT, "position_mode: 8 ": "missed_syncs: 500\n  position_mode: 8 "}.items():
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    bus.write_text(text)
    return target


def copy_looped_arm(folder, kind, **gains):
    """Copy arm6's files: velocities or efforts are commanded, by PIDs under a trajectory controller."""
    target = copy_arm(folder)
    index, mode = CYCLIC[kind]
    bus, urdf, control = (target / name for name in ("bus.yml", "arm6.urdf", "ros2_controllers.yaml"))
    text = bus.read_text().replace("index: 0x607A", f"index: {index}")
    bus.write_text(text.replace("position_mode: 8", f"{kind}_mode: {mode}"))
    text = urdf.read_text()
    urdf.write_text(text.replace('<command_interface name="position"/>', f'<command_interface name="{kind}"/>'))
    loops = LOOPS.replace("KIND", kind) + "".join(f"      {joint}: {gains}\n" for joint in JOINTS).replace("'", "")
    text = control.read_text().replace("\narm_controller:\n", loops + "\narm_controller:\n", 1)
    names = ", ".join(f"loops/{joint}" for joint in JOINTS)
    control.write_text(
        text.replace(
            "command_interfaces: [position]", f"command_joints: [{names}]\n    command_interfaces: [position, velocity]"
        )
    )
    return target
