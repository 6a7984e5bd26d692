import pytest
from support.onbus import GENERIC, TMCM

from canopen_control.cia402.modes import OperationMode
from canopen_control.cli.support.jog_robot import choose_tuned
from canopen_control.cli.support.target import find_eds
from canopen_control.commissioning.jog_motion import JogKind
from canopen_control.od.eds import read_eds
from canopen_control.scaffold.bus_text import bus_text
from canopen_control.scaffold.new_robot import Device


@pytest.mark.parametrize(
    ("eds", "mode", "transmission"), [(GENERIC, OperationMode.CSV, 1), (TMCM, OperationMode.PV, 255)]
)
def test_a_drive_is_excited_without_its_own_ramp_where_it_can_be(private_folders, eds, mode, transmission):
    device = Device(5, find_eds(eds), read_eds(find_eds(eds), 5).od)
    robot = choose_tuned(device, JogKind.VELOCITY, 5000, allow_unsupervised=True)
    assert robot.joints[0].axis.mode is mode
    assert {use.transmission for use in robot.nodes[0].drive.rpdos} == {transmission}
    text = bus_text(robot)
    assert f"velocity_mode: {int(mode)}" in text
    assert "sync_period: 5000" in text
    assert ("0x6077" in text) == (eds == GENERIC)  # its torque comes with every SYNC
