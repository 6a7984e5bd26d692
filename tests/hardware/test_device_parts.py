"""<gpio> and <sensor> of the description as signals of virtual devices, on the memory bus."""

import math

import pytest
from support.devices import IO, DeviceBench, with_device, with_measured_joint

from canopen_control.data_files import data_path
from canopen_control.errors import RobotConfigError
from canopen_control.frame import rpdo_cob_id
from canopen_control.runtime.status import status_message

EDS = "generic_cia401.eds"
STATES = ("di0", "di11", "ai0", "do0", "ao1", "0x6000:01")
COMMANDS = ("do0", "do1", "ao1")
SIGNALS = {"signals": [{"name": "ai0", "factor": 10 / 32767, "unit": "V"}, {"name": "ao1", "factor": 10 / 32767}]}


@pytest.fixture
def io(tmp_path, request):
    config = with_device(tmp_path, EDS, STATES, commands=COMMANDS, keys=SIGNALS)
    bench = DeviceBench("device-parts", config, controllers=("robby_forward_controller", "outputs"))
    yield bench
    bench.close()


def command(bench, *values):
    bench.robot.command("outputs", list(values), "test")
    bench.run(60)


def test_inputs_are_known_from_the_boot_on_and_follow_the_device(io):
    io.set(di11=1)
    io.start()
    assert [io.state(f"io/{name}") for name in ("di0", "di11", "ai0")] == [0.0, 1.0, 0.0]
    io.set(di0=1, ai0=16384)
    io.run(60)
    assert io.state("io/di0") == 1.0
    assert io.state("io/ai0") == pytest.approx(5.0, abs=0.001)
    assert io.state("io/0x6000:01") == 1.0


def test_a_sudden_silence_makes_all_of_it_unknown(io):
    io.start()
    io.set(di0=1)
    io.run(60)
    io.power_off(IO)
    io.run(1500)
    assert all(math.isnan(io.state(f"io/{name}")) for name in STATES)


def test_outputs_are_sent_in_units_when_they_are_commanded(io):
    io.start()
    assert [io.terminal(name) for name in COMMANDS] == [0.0] * 3
    command(io, 1.0, 0.0, 5.0)
    assert [io.terminal("do0"), io.terminal("do1")] == [1.0, 0.0]
    assert io.terminal("ao1") == pytest.approx(16384, abs=1)
    assert io.state("io/do0") == 1.0
    assert io.state("io/ao1") == pytest.approx(5.0, abs=0.001)


def test_an_output_that_nobody_commanded_is_never_sent(io):
    io.start()
    io.run(300)
    rpdos = {rpdo_cob_id(1, IO), rpdo_cob_id(2, IO)}
    assert [pdo.count for pdo in io.robot.nodes["io"].sent if pdo.cob_id in rpdos] == [0, 0]


def test_an_output_is_not_restored_when_its_node_restarts(io):
    io.start()
    command(io, 1.0, 1.0, 2.0)
    io.power_off(IO)
    io.run(1500)
    io.power_on(IO)
    io.until(lambda: io.robot.nodes["io"].ready)
    io.run(200)
    assert [io.terminal(name) for name in COMMANDS] == [0.0] * 3
    assert io.state("io/do0") == 0.0
    command(io, 0.0, 1.0, 0.0)
    assert [io.terminal("do0"), io.terminal("do1")] == [0.0, 1.0]


def test_a_device_that_disappears_is_told_with_what_is_void(io):
    io.start()
    command(io, 1.0, 0.0, 2.0)
    io.power_off(IO)
    io.run(1500)
    assert io.texts("device_lost") == [
        "node 5 (io): lost: its inputs are unknown; of its outputs do0, do1, ao1 are void, "
        "and not restored until commanded anew"
    ]
    assert status_message(io.robot).nodes["io"].void_outputs == ("do0", "do1", "ao1")
    io.power_on(IO)
    io.until(lambda: io.robot.nodes["io"].ready)
    io.run(200)
    assert status_message(io.robot).nodes["io"].void_outputs == ("do0", "do1", "ao1")
    command(io, 1.0, 1.0, 0.0)
    io.run(200)
    assert "do1" not in status_message(io.robot).nodes["io"].void_outputs


def test_the_end_of_the_robot_sends_safe_values_to_a_module_that_knows_no_error_modes(tmp_path):
    text = data_path("eds", EDS).read_text()
    for index in ("6206", "6207", "6443", "6444"):
        text = text.replace(f"[{index}", f"[{int(index, 16) - 0x3000:04X}").replace(f"=0x{index}\n", "=0x3FFF\n")
    config = with_device(tmp_path, "plain.eds", STATES, commands=COMMANDS)
    (config / "plain.eds").write_text(text)
    bench = DeviceBench("device-plain", config, controllers=("outputs",))  # no drive has to come to rest
    try:
        bench.start()
        command(bench, 1.0, 1.0, 2.0)
        bench.robot.shutdown("the test")
        bench.run(300)
        assert bench.robot.nodes["io"].sent[0].count == 2  # the command and the safe values
        assert [bench.terminal(name) for name in COMMANDS] == [0.0] * 3
    finally:
        bench.close()


def test_what_moves_an_axis_is_not_commanded_past_its_joint(tmp_path):
    part = '<param name="device_name">left_drive</param><command_interface name="0x6040:00"/>'
    with pytest.raises(RobotConfigError, match=r"'0x6040:00' of drive .* moves an axis; a joint commands it"):
        DeviceBench("device-axis", with_device(tmp_path, EDS, (), parameters=part, name="io"))


def test_a_joint_that_an_encoder_measures_stands_in_joint_states(tmp_path):
    bench = DeviceBench("device-joint", with_measured_joint(tmp_path))
    try:
        bench.set(position=0.5)
        bench.start()
        bench.run(100)
        sample = bench.robot.manager.running.samples(0)["joint_state_broadcaster"]
        assert "arm_joint" in sample.names
        assert sample.joints["arm_joint"]["position"] == pytest.approx(0.5, abs=1e-3)
    finally:
        bench.close()


def test_outputs_take_their_error_values_when_the_master_dies(io):
    io.start()
    command(io, 1.0, 1.0, 2.0)
    io.robot.close()
    io.run(2000)
    assert [io.terminal(name) for name in COMMANDS] == [0.0] * 3


def test_a_controller_that_lets_go_leaves_its_outputs_safe(io):
    io.start()
    command(io, 1.0, 0.0, 2.0)
    io.robot.switch([], ["outputs"], strict=True)
    io.run(60)
    assert [io.terminal(name) for name in COMMANDS] == [0.0] * 3


def test_on_release_keep_leaves_them_as_they_are(tmp_path):
    keep = '<param name="on_release">keep</param>'
    config = with_device(tmp_path, EDS, STATES, commands=COMMANDS, parameters=keep)
    bench = DeviceBench("device-keep", config, controllers=("robby_forward_controller", "outputs"))
    try:
        bench.start()
        command(bench, 1.0, 0.0, 2.0)
        bench.robot.switch([], ["outputs"], strict=True)
        bench.run(60)
        assert bench.terminal("do0") == 1.0
    finally:
        bench.close()


def test_all_mistakes_of_a_part_are_told_at_once(tmp_path):
    config = with_device(tmp_path, EDS, ("di99", "ai0"), commands=("di0", "do0"))
    with pytest.raises(RobotConfigError) as caught:
        DeviceBench("device-wrong", config)
    said = str(caught.value)
    assert "no signal 'di99' of I/O module (CiA 401) io, did you mean 'di9'?" in said
    assert "'di0' of I/O module (CiA 401) io is an input; make it a state_interface" in said


def test_a_part_of_another_name_says_which_node_it_is(tmp_path):
    wrong = '<param name="device_name">io1</param>'
    with pytest.raises(RobotConfigError, match=r"'io1' is no node of bus\.yml, did you mean 'io'"):
        DeviceBench("device-named", with_device(tmp_path, EDS, ("di0",), parameters=wrong))
