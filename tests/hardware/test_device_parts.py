"""<gpio> and <sensor> of the description as signals of virtual devices, on the memory bus."""

import math
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.devices import IO, DeviceBench, with_device, with_measured_joint
from support.virtualbench import MS, S, T, entry

from canopen_control.cia301.pdo import MappedObject
from canopen_control.data_files import data_path
from canopen_control.errors import RobotConfigError
from canopen_control.frame import rpdo_cob_id
from canopen_control.hardware.device_parts import POLL_NS, InputSignal, NodeInputs, OutputSignal
from canopen_control.hardware.interfaces import CommandInterface, StateInterface
from canopen_control.master.cycle import ProcessImage
from canopen_control.profiles import Signal, SignalScale
from canopen_control.runtime.status import status_message


class Line:
    """An output of a node that is there; `sent` counts what is due."""

    def __init__(self, signal, data_type=T.UNSIGNED8, **how):
        self.node = SimpleNamespace(
            ready=True, boots=1, identity=None, od={signal.address: entry(*signal.address, data_type)}
        )
        self.image = ProcessImage()
        mapped = MappedObject(*signal.address, data_type.bits, data_type)
        self.pdo = self.image.add_rpdo(5, 0x205, [mapped])
        self.pdo.start()
        self.object = self.image.output(5, *signal.address)
        self.command = CommandInterface("io", signal.name)
        self.output = OutputSignal(signal, self.command, self.object, self.node, **how)
        self.output.write()

    def sends(self, value):
        """Command a value, and return what is sent for it, None: nothing."""
        self.command.value = value
        self.output.write()
        due, self.pdo.changed = self.pdo.changed, False
        return self.object.value if due else None


LAMP = Signal("lamp", 0x6200, 1, output=True, bit=2)
VALVE = Signal("valve", 0x6411, 1, output=True, factor=0.5, offset=1.0, safe=3.0)


def test_a_bit_is_sent_with_the_others_of_its_object_as_they_are():
    line = Line(LAMP)
    line.object.record(0x81)
    assert [line.sends(value) for value in (1.0, 1.0, 0.0)] == [0x85, None, 0x81]


def test_the_first_command_is_sent_also_where_it_changes_nothing():
    line = Line(LAMP)
    assert [line.sends(value) for value in (math.nan, 0.0, 0.0)] == [None, 0, None]


def test_a_value_is_sent_in_raw_numbers_and_no_further_than_the_object_goes():
    line = Line(VALVE, T.INTEGER16)
    assert [line.sends(value) for value in (3.0, 1e9, -1e9, math.inf)] == [4, 32767, -32768, None]
    assert (line.command.lowest, line.command.highest) == (1.0 - 16384.0, 1.0 + 16383.5)


@pytest.mark.parametrize("goes_on", [True, False])
def test_what_was_commanded_before_the_node_was_lost_is_void(goes_on):
    line = Line(LAMP)
    assert line.sends(1.0) == 4
    line.node.ready = False
    assert not line.output.void
    assert line.sends(1.0) is None
    assert line.output.void
    assert not line.command.enabled
    line.node.ready, line.node.boots = True, 2
    line.object.record(0)
    assert line.sends(1.0 if goes_on else math.nan) is None
    assert line.command.enabled
    if goes_on:  # a controller that writes the same in each cycle has not commanded again
        assert [line.sends(1.0), line.sends(1.0)] == [None, None]
        assert line.output.void
        assert [line.sends(0.0), line.sends(1.0)] == [0, 4]
    else:
        assert line.sends(1.0) == 4
    assert not line.output.void


@given(
    st.lists(st.tuples(st.sampled_from(["command", "lost", "back", "release"]), st.sampled_from([0.0, 1.0, math.nan])))
)
def test_whatever_was_before_a_restart_sends_nothing_by_what_stands_commanded(history):
    line = Line(LAMP)
    for what, value in history:
        if what == "command":
            line.sends(value)
        elif what == "release":
            line.output.release()
        else:
            line.node.ready = what == "back"
            line.node.boots += 1
            line.output.write()
    line.pdo.start()  # what waited to be sent went with the node
    standing = line.command.value
    for ready in (False, True):
        line.node.ready = ready
        line.node.boots += ready
        assert line.sends(standing) is None
    assert [line.sends(standing) for _ in range(3)] == [None] * 3
    other = 1.0 if standing != 1.0 else 0.0
    assert line.sends(other) is not None


def test_released_it_takes_its_safe_value_unless_it_keeps_what_it_has():
    line = Line(VALVE, T.INTEGER16)
    line.output.release()
    assert line.object.value == 0  # it had no command
    line.sends(10.0)
    line.output.release()
    assert line.object.value == 4
    assert math.isnan(line.command.value)
    keeping = Line(VALVE, T.INTEGER16, keeps=True)
    keeping.sends(10.0)
    keeping.output.release()
    assert keeping.object.value == 18


@pytest.mark.parametrize(("reported", "raw"), [(None, 4), (5.0, 8), (math.nan, 20)])
def test_a_released_output_takes_the_value_of_its_controller_or_its_safe_value(reported, raw):
    line = Line(VALVE, T.INTEGER16)
    assert line.command.safe == 3.0
    line.sends(11.0)
    line.command.release_value = reported
    line.output.release()
    assert line.object.value == raw
    assert line.command.release_value is None


def test_one_that_is_to_keep_what_it_has_reports_this():
    assert math.isnan(Line(VALVE, T.INTEGER16, keeps=True).command.safe)


VALUE, STATUS, RANGE = (0x7130, 1), (0x6150, 1), (0x6002, 0)


class Node:
    """A node whose TPDO carries 0x7130:01 and 0x6150:01; the rest is asked by SDO."""

    def __init__(self, signal, presets=()):
        types = {VALUE: T.INTEGER16, STATUS: T.UNSIGNED8, RANGE: T.UNSIGNED32, (0x6060, 0): T.UNSIGNED32}
        self.asked = []
        self.node = SimpleNamespace(
            node_id=5,
            ready=True,
            boots=1,
            identity=SimpleNamespace(presets=dict(presets)),
            od={address: entry(*address, kind) for address, kind in types.items()},
            read=lambda index, subindex, done: self.asked.append(((index, subindex), done)),
        )
        self.image = ProcessImage()
        mapped = [MappedObject(*address, types[address].bits, types[address]) for address in (VALUE, STATUS)]
        self.pdo = self.image.add_tpdo(5, 0x185, mapped)
        self.inputs = NodeInputs(self.node, self.image)
        self.state = StateInterface("io", signal.name)
        self.signal = InputSignal(signal, self.state, self.inputs)
        self.now = S

    def receives(self, raw, status=0):
        data = raw.to_bytes(2, "little", signed=True) + bytes((status,))
        self.pdo.receive(data.ljust(8, b"\0"), 3, self.now)
        return self.value()

    def value(self):
        self.inputs.read(self.now)
        self.signal.read(self.now)
        return self.state.value


PLAIN = Signal("ai0", *VALUE, factor=0.1)


def test_it_is_unknown_until_the_boot_has_read_it_or_its_tpdo_comes():
    assert math.isnan(Node(PLAIN).value())
    assert Node(PLAIN, {VALUE: 30}).value() == pytest.approx(3.0)
    assert Node(PLAIN).receives(-20) == pytest.approx(-2.0)


def test_one_that_comes_when_it_changes_has_no_age_and_one_with_a_timer_has():
    node = Node(PLAIN)
    node.receives(10)
    node.now += 3600 * S
    assert node.value() == pytest.approx(1.0)
    node.pdo.age_limit_ns = 300 * MS
    assert math.isnan(node.value())
    assert node.receives(11) == pytest.approx(1.1)
    node.now += 300 * MS
    assert node.value() == pytest.approx(1.1)
    node.now += 1
    assert math.isnan(node.value())


def test_it_is_unknown_while_its_node_is_lost_or_its_tpdo_is_overdue():
    node = Node(PLAIN)
    node.receives(10)
    node.pdo.overdue = True
    assert math.isnan(node.value())
    node.pdo.overdue = False
    node.node.ready = False
    assert math.isnan(node.value())
    node.node.ready = True
    node.pdo.forget()
    node.node.boots = 2
    assert math.isnan(node.value())  # what was received before counts no more


def test_what_the_device_calls_invalid_is_none():
    node = Node(Signal("ai0", *VALUE, status=STATUS))
    assert node.receives(5, 0) == 5.0
    assert math.isnan(node.receives(5, 1))
    assert node.receives(6, 0) == 6.0


def test_the_devices_scale_of_the_newest_boot_counts():
    node = Node(Signal("ai0", *VALUE, scales=(SignalScale(STATUS, float, 1),)), {STATUS: 3})
    assert node.receives(5) == 15.0
    node.node.identity.presets[STATUS] = 4
    node.node.boots = 2
    assert node.receives(5) == 20.0


def test_a_position_continues_where_the_device_begins_again():
    node = Node(Signal("position", *VALUE, unwrap=RANGE), {RANGE: 1000})
    assert [node.receives(raw) for raw in (900, 990, 10, 500, 999, 5, 990)] == [900, 990, 1010, 1500, 1999, 2005, 1990]
    node.node.ready = False
    node.value()
    node.node.ready = True
    assert node.receives(700) == 700.0  # the motion was not observed


def test_another_type_is_taken_where_the_file_is_wrong():
    node = Node(Signal("x", *VALUE, data_type=T.UNSIGNED16))
    assert node.receives(-1) == 65535.0


def test_what_no_tpdo_carries_is_asked_for_now_and_then_and_ages():
    node = Node(Signal("v", 0x6060, factor=1 / 1024))
    assert math.isnan(node.value())
    node.inputs.poll(node.now)
    node.inputs.poll(node.now)
    ((address, done),) = node.asked
    assert address == (0x6060, 0)
    done(SimpleNamespace(error=None, data=(24 * 1024).to_bytes(4, "little")))
    assert node.value() == 24.0
    done(SimpleNamespace(error=None, data=b"\0"))  # an answer of another length is ignored
    done(SimpleNamespace(error=TimeoutError(), data=b""))
    assert node.value() == 24.0
    node.now += POLL_NS
    node.inputs.poll(node.now)
    assert len(node.asked) == 2
    node.now += 5 * POLL_NS
    assert math.isnan(node.value())


def test_what_changes_faster_than_it_can_has_jumped_and_is_reported_once():
    node = Node(Signal("level", *VALUE, max_rate=100.0, unit="m"), {VALUE: 0})
    for raw in (0, 5, 10):  # 5 in 50 ms
        assert node.receives(raw) == raw
        node.now += 50 * MS
    assert math.isnan(node.receives(16))
    node.now += S
    assert math.isnan(node.receives(16))
    assert node.inputs.jumps == ["io/level jumped from 10 to 16 m; its value is nan until the node has booted again"]
    node.node.boots, node.node.identity.presets[VALUE] = 2, 16
    assert node.receives(16) == 16.0


@pytest.mark.parametrize(("age_limit", "jumped"), [(0, True), (3 * S, False)])
def test_one_that_only_comes_when_it_changes_has_stood_still_while_it_was_silent(age_limit, jumped):
    node = Node(Signal("level", *VALUE, max_rate=100.0))
    node.receives(0)
    node.pdo.age_limit_ns = age_limit
    node.now += 2 * S
    assert math.isnan(node.receives(50)) is jumped  # 200 would be its way in that time, 5 the one in 50 ms
    node.now += 2 * S
    assert math.isnan(node.receives(51)) is jumped


def test_frames_that_come_together_are_not_jump():
    node = Node(Signal("level", *VALUE, max_rate=100.0))
    node.receives(0)
    node.now += 1
    assert node.receives(5) == 5.0


STATES_OF_DERIVED_SIGNALS = {
    406: ("position", "position_absolute", "velocity"),
    410: ("longitudinal", "lateral", *(f"orientation.{axis}" for axis in "xyzw"), "angular_velocity.x"),
    404: ("ai0", "ai1", "status0"),
    418: ("battery_voltage", "battery_temperature", "battery_percentage", "0x6081"),
}


@pytest.fixture
def robot(tmp_path, request):
    number = request.param
    config = with_device(tmp_path, f"generic_cia{number}.eds", STATES_OF_DERIVED_SIGNALS[number], tag="sensor")
    bench = DeviceBench(f"sensor-{number}", config)
    yield bench
    bench.close()


def states(bench, *names):
    return [bench.state(f"io/{name}") for name in names]


@pytest.mark.parametrize("robot", [406], indirect=True)
def test_an_encoder_continues_beyond_its_range_and_reports_its_velocity(robot):
    turns = math.tau * 4095.75
    robot.set(position=turns)
    robot.start()
    assert states(robot, "position")[0] == pytest.approx(turns)
    robot.set(position=turns + 1.0, velocity=2.0)
    robot.run(1000)
    position, absolute, velocity = states(robot, *STATES_OF_DERIVED_SIGNALS[406])
    assert position == pytest.approx(turns + 3.0, abs=0.1)
    assert absolute == pytest.approx((turns + 3.0) % (math.tau * 4096), abs=0.1)
    assert velocity == pytest.approx(2.0, abs=0.2)
    robot.set(velocity=0.0)
    robot.run(300)
    assert states(robot, "velocity") == [0.0]


@pytest.mark.parametrize("robot", [406], indirect=True)
def test_an_encoder_that_is_silent_is_unknown(robot):
    robot.start()
    robot.power_off(robot.device_id)
    robot.run(200)  # before the heartbeat is missed
    assert all(math.isnan(state) for state in states(robot, *STATES_OF_DERIVED_SIGNALS[406]))


@pytest.mark.parametrize("robot", [410], indirect=True)
def test_two_angles_are_an_orientation_without_heading(robot):
    robot.start()
    robot.set(lateral=0.2, longitudinal=-0.1)
    robot.run(100)
    x, y, z, w = states(robot, *(f"orientation.{axis}" for axis in "xyzw"))
    assert x * x + y * y + z * z + w * w == pytest.approx(1.0)
    assert math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)) == pytest.approx(0.2, abs=2e-4)
    assert math.asin(2 * (w * y - z * x)) == pytest.approx(-0.1, abs=2e-4)
    assert math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) == pytest.approx(0.0, abs=1e-9)
    assert math.isnan(states(robot, "angular_velocity.x")[0])


@pytest.mark.parametrize("robot", [404], indirect=True)
def test_a_measured_value_with_a_status_is_none(robot):
    robot.start()
    robot.set(ai0=21.5, ai1=3.3)
    robot.run(60)
    assert states(robot, "ai0", "ai1") == [pytest.approx(21.5), pytest.approx(3.3)]
    robot.set(status0=1)
    robot.run(60)
    assert math.isnan(states(robot, "ai0")[0])
    assert states(robot, "ai1", "status0") == [pytest.approx(3.3), 1.0]


@pytest.mark.parametrize("robot", [418], indirect=True)
def test_a_battery_is_reported_in_units(robot):
    robot.start()
    robot.run(1100)
    assert states(robot, *STATES_OF_DERIVED_SIGNALS[418]) == [pytest.approx(25.6, abs=1e-3), 25.0, 80.0, 80.0]


def test_an_encoder_that_jumps_is_reported_once_and_has_neither_position_nor_velocity(tmp_path):
    keys = {"signals": [{"name": "position", "max_rate": 20.0}]}
    bench = DeviceBench("sensor-jump", with_device(tmp_path, "generic_cia406.eds", ("position", "velocity"), keys=keys))
    try:
        bench.start()
        bench.set(velocity=10.0)
        bench.run(500)
        assert bench.state("io/position") == pytest.approx(5.0, abs=0.5)
        bench.device.fault_switches.set("input_jump", True, bench.reactor.now())
        bench.run(100)
        assert math.isnan(bench.state("io/position"))
        assert math.isnan(bench.state("io/velocity"))
        (reported,) = bench.texts("input_jumped")
        assert reported.startswith("node 5 (io): io/position jumped from")
    finally:
        bench.close()


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


def test_an_output_without_a_command_is_never_sent(io):
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


def test_a_device_that_disappears_is_reported_with_the_lost_commands(io):
    io.start()
    command(io, 1.0, 0.0, 2.0)
    io.power_off(IO)
    io.run(1500)
    assert io.texts("device_lost") == [
        "node 5 (io): lost: its inputs are unknown; the commands of do0, do1, ao1 are void until commanded again"
    ]
    assert status_message(io.robot).nodes["io"].void_outputs == ("do0", "do1", "ao1")
    io.power_on(IO)
    io.until(lambda: io.robot.nodes["io"].ready)
    io.run(200)
    assert status_message(io.robot).nodes["io"].void_outputs == ("do0", "do1", "ao1")
    command(io, 1.0, 1.0, 0.0)
    io.run(200)
    assert "do1" not in status_message(io.robot).nodes["io"].void_outputs


def test_the_end_of_the_robot_sends_safe_values_to_a_module_without_error_modes(tmp_path):
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
    with pytest.raises(RobotConfigError, match=r"'0x6040:00' of drive .* moves an axis; command it through a joint"):
        DeviceBench("device-axis", with_device(tmp_path, EDS, (), parameters=part, name="io"))


def test_a_joint_that_an_encoder_measures_is_in_joint_states(tmp_path):
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


def test_a_deactivated_controller_leaves_its_outputs_safe(io):
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


def test_all_errors_of_a_part_are_reported_at_once(tmp_path):
    config = with_device(tmp_path, EDS, ("di99", "ai0"), commands=("di0", "do0"))
    with pytest.raises(RobotConfigError) as caught:
        DeviceBench("device-wrong", config)
    message = str(caught.value)
    assert "no signal 'di99' of I/O module (CiA 401) io (did you mean 'di9'?)" in message
    assert "'di0' of I/O module (CiA 401) io is an input; make it a state_interface" in message


def test_outputs_of_one_object_without_an_rpdo_share_a_sentence(tmp_path):
    bits = tuple(f"do{bit}" for bit in range(8))
    config = with_device(tmp_path, EDS, (), commands=(*bits, "ao1"), keys={"rpdo": {1: {"enabled": False}}})
    with pytest.raises(RobotConfigError) as caught:
        DeviceBench("device-unmapped", config)
    lines = [line for line in str(caught.value).splitlines() if "in no RPDO" in line]
    assert len(lines) == 2
    assert "'do0', 'do1', 'do2', 'do3', 'do4', 3 more of I/O module (CiA 401) io are in no RPDO" in lines[0]
    assert lines[0].endswith("; map 0x6200:01 in bus.yml")
    assert "'ao1' of I/O module (CiA 401) io is in no RPDO; map 0x6411:02 in bus.yml" in lines[1]


def test_an_output_that_cannot_be_mapped_is_not_to_be_mapped(tmp_path):
    text = data_path("eds", EDS).read_text()
    head, result, tail = text.partition("[6411sub2]")
    assert result
    (tmp_path / "sdo_only.eds").write_text(head + result + tail.replace("PDOMapping=1", "PDOMapping=0", 1))
    off = {"rpdo": {2: {"enabled": False}}}
    config = with_device(tmp_path, str(tmp_path / "sdo_only.eds"), (), commands=("ao0", "ao1"), keys=off)
    with pytest.raises(RobotConfigError) as caught:
        DeviceBench("device-sdo-only", config)
    message = str(caught.value)
    assert "'ao0' of I/O module (CiA 401) io is in no RPDO; map 0x6411:01 in bus.yml" in message
    assert "'ao1' of I/O module (CiA 401) io is in no RPDO; 0x6411:02 cannot be mapped: remove it" in message


def test_a_part_of_another_name_specifies_which_node_it_is(tmp_path):
    wrong = '<param name="device_name">io1</param>'
    with pytest.raises(RobotConfigError, match=r"'io1' is not a node of bus\.yml \(did you mean 'io'"):
        DeviceBench("device-named", with_device(tmp_path, EDS, ("di0",), parameters=wrong))
