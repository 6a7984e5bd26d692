"""Every fault of the device is seen on the wire, and the drive is healthy again after it is switched off."""

from __future__ import annotations

import contextlib
import struct

import pytest
from support.devices import put, virtual
from support.faulty import Faulty, bench, fault
from support.programs import program_od
from support.setpoints import StreamBench
from support.virtualbench import tmcm

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.errors import ConfigError
from canopen_control.virtual.communication_objects import whole_program
from canopen_control.virtual.device import make_device
from canopen_control.virtual.fault_table import FaultSwitches


@pytest.mark.parametrize(
    ("name", "code"),
    [
        (fault("drive_fault"), 0x4310),
        (fault("short_circuit"), 0x2320),
        (fault("undervoltage"), 0x3220),
        (fault("following_error"), 0x8611),
    ],
)
def test_a_fault_whose_cause_lasts(name, code):
    b = bench().enable(3)
    b.seen.clear()
    b.set(name)
    b.on(0.1)
    assert b.state == "FAULT"
    assert [frame.data[:2] for _, frame in b.seen if frame.can_id == 0x085] == [struct.pack("<H", code)]
    b.control(0x80)
    assert b.state == "FAULT"
    b.set(name, False)
    b.control(0)
    b.control(0x80)
    assert b.state == "SWITCH_ON_DISABLED"
    b.enable(3)
    assert b.state == "OPERATION_ENABLED"


def test_a_fault_that_needs_a_reset_of_the_communication():
    b = bench().enable(3)
    b.set(fault("fault_needs_reset"))
    b.on(0.1)
    for word in (0x80, 0, 0x80, 0):
        b.control(word)
    assert b.state == "FAULT"
    b.nmt(NmtCommand.RESET_COMMUNICATION)
    b.on(0.1)
    b.control(0x80)
    assert b.state == "SWITCH_ON_DISABLED"


def test_a_fault_on_enable_and_a_reset_that_is_not_received():
    b = bench()
    b.set(fault("fault_on_enable"))
    b.enable(3)
    b.on(0.1)
    assert (b.state, b.number(0x603F)) == ("FAULT", 0x5441)
    b.set("fault_on_enable", False)
    b.set(fault("fault_reset_ignored"))
    b.control(0x80)
    assert b.state == "FAULT"
    b.set("fault_reset_ignored", False)
    b.control(0)
    b.control(0x80)
    b.enable(3)
    assert b.state == "OPERATION_ENABLED"


def test_enabled_by_sdo_in_pre_operational():
    b = bench()
    b.on(0.1)
    b.set(fault("enabled_in_preop"))
    for word in (6, 7, 15):
        b.write(0x6040, word)
    assert b.state == "OPERATION_ENABLED"
    b.write(0x6040, 7)
    b.set("enabled_in_preop", False)
    b.write(0x6040, 15)
    assert b.state == "SWITCHED_ON"


def test_slow_transitions():
    b = bench()
    b.start()
    b.set(fault("transition_slow"))
    b.control(6)
    b.on(1.9)
    assert b.state == "SWITCH_ON_DISABLED"
    b.on(0.2)
    assert b.state == "READY_TO_SWITCH_ON"
    b.control(0x0F)  # held: 3, then 4
    b.on(4.1)
    assert b.state == "OPERATION_ENABLED"
    b.set("transition_slow", False)
    b.control(7)
    b.on(0)
    assert b.state == "SWITCHED_ON"


def test_the_power_stage_off():
    b = bench().enable(3)
    b.set(fault("power_stage_off"))
    assert b.state == "SWITCH_ON_DISABLED"
    assert not b.statusword & 0x10
    b.set("power_stage_off", False)
    b.enable(3)
    assert b.statusword & 0x7F == 0x37


@pytest.mark.parametrize(
    ("name", "mask", "faulty"),
    [
        (fault("undefined_statusword"), 0xFFFF, 0x0001),
        (fault("local_control"), 0x0200, 0),
        (fault("warning"), 0x0080, 0x0080),
        (fault("pp_ack_stuck"), 0x1000, 0x1000),
        (fault("target_reached_stale"), 0x0400, 0x0400),
        (fault("pp_ack_missing"), 0x1000, 0),
    ],
)
def test_bits_of_the_statusword(name, mask, faulty):
    b = bench().enable(1)
    b.write(0x607A, 5000)
    if name != "pp_ack_stuck":
        b.control(0x1F)
    b.on(0.1)
    healthy = b.number(0x6041) & mask
    assert healthy != faulty
    b.set(name)
    assert b.number(0x6041) & mask == faulty
    b.set(name, False)
    assert b.number(0x6041) & mask == healthy


def test_the_mode_display():
    b = bench()
    b.write(0x6060, 1)
    b.set(fault("mode_display_stuck"))
    b.write(0x6060, 3)
    b.on(10)
    assert b.number(0x6061) == 1
    b.set("mode_display_stuck", False)
    b.write(0x6060, 3)
    assert b.number(0x6061) == 3
    b.set(fault("mode_display_late"))
    b.write(0x6060, 8)
    b.on(0.19)
    assert b.number(0x6061) == 3
    b.on(0.02)
    assert b.number(0x6061) == 8
    b.set("mode_display_late", False)
    b.write(0x6060, 3)
    assert b.number(0x6061) == 3


def test_positions():
    b = bench()
    b.set(fault("hand_moved"))
    assert b.position == 500
    b.set(fault("position_jump"))
    assert b.position == 1_000_500
    b.set(fault("position_wrap"))
    assert b.position == 0x7FFFFFFF - 1000
    b.enable(3)
    b.write(0x60FF, 10_000)
    b.on(1.5)
    assert b.position < 0
    b.set(fault("direction_inverted"))
    assert b.velocity == -10_000
    b.set("direction_inverted", False)
    assert b.velocity == 10_000


def test_a_limit_switch():
    b = bench().enable(3)
    b.write(0x60FF, 1000)
    b.on(1)
    b.set(fault("limit_switch"))
    b.on(1)
    assert b.velocity == 0
    assert b.statusword & 0x0800
    assert b.number(0x60FD) & 2
    b.write(0x60FF, 2000)
    b.on(1)
    assert b.velocity == 0
    b.write(0x60FF, -1000)
    b.on(1)
    assert b.velocity == -1000
    b.set("limit_switch", False)
    b.write(0x60FF, 1000)
    b.on(2)
    assert b.velocity == 1000


def test_the_tmcm_1270_reports_its_limit_switch_unless_its_switches_are_disabled():
    b = Faulty(tmcm())
    for index in (0x6083, 0x6085):
        b.write(index, 16000)
    b.enable(3)
    b.write(0x60FF, 1000)
    b.on(1)
    b.seen.clear()
    b.set("limit_switch")
    b.on(1)
    assert [frame.data[:4].hex() for _, frame in b.seen if frame.can_id == 0x083] == ["01ff8103", "00000000"]
    b.write(0x2005, 3)
    b.write(0x60FF, 900)
    b.on(1)
    assert b.velocity == 900


@pytest.mark.rest
def test_homing_that_fails_and_homing_without_end():
    b = bench(x6098=17).enable(6)
    b.set(fault("homing_fails"))
    b.control(0x1F)
    b.on(1)
    assert b.statusword & 0x3400 == 0x2400
    b.set("homing_fails", False)
    b.control(0x0F)
    b.set(fault("homing_endless"))
    b.control(0x1F)
    b.on(600)
    assert b.statusword & 0x3400 == 0
    b.set("homing_endless", False)
    b.control(0x0F)
    b.on(10)
    b.control(0x1F)
    b.on(10_000)  # from far beyond the switch, slowly
    assert b.statusword & 0x3400 == 0x1400


@pytest.mark.parametrize(("name", "sub"), [(fault("wrong_identity"), 2), (fault("wrong_revision"), 3)])
def test_the_identity(name, sub):
    b = bench()
    healthy = b.number(0x1018, sub)
    b.set(name)
    assert b.number(0x1018, sub) == healthy + 1
    b.set(name, False)
    assert b.number(0x1018, sub) == healthy


def test_a_clamped_parameter():
    b = bench()
    b.set(fault("parameter_clamped"))
    b.write(0x6083, 5000)
    assert b.number(0x6083) == 1000
    b.set("parameter_clamped", False)
    b.write(0x6083, 5000)
    assert b.number(0x6083) == 5000


def streamed(name):
    """A stream of a hundred and one set-points with a fault on, in simulated time."""
    b = StreamBench()
    FaultSwitches(b.node).set(fault(name), True, b.now)
    b.ramp(102, settle=1)
    return b


def test_rpdos_that_come_late_show_their_phase_and_one_that_is_lost_is_missed():
    late = streamed(fault("rpdo_late"))
    late.on(0.003)  # the last one, 3 ms after the SYNC that was to make it count
    assert (late.quality.phase_us.min, late.quality.phase_us.max) == pytest.approx((3000, 3000))
    assert late.quality.velocity_ripple == pytest.approx(0, abs=1e-6)
    lossy = streamed(fault("rpdo_lost"))
    assert (lossy.quality.missed, lossy.quality.taken) == (1, 100)
    for b, seam in ((late, late.node.pdos.input.delay_ns), (lossy, lossy.node.pdos.input.lost)):
        for name in b.node.fault_switches.active:
            b.node.fault_switches.set(name, False, b.now)
        assert seam.value == 0


@pytest.mark.parametrize(
    ("name", "shown"),
    [(fault("input_stuck"), {1000}), (fault("input_jump"), {2000 + 8192}), (fault("input_noise"), None)],
)
def test_inputs_of_a_device_that_lie(name, shown):
    b = virtual(401)
    switches = FaultSwitches(b.node)
    put(b, ai0=1000)
    switches.set(name, True, b.now)
    put(b, ai0=2000)
    observed = {b.on(0.02).number(0x6401, 1) for _ in range(6)}
    assert observed == shown if shown else len(observed) > 2
    switches.set(name, False, b.now)
    assert b.number(0x6401, 1) == 2000


def test_an_error_of_the_hardware_is_reported_and_taken_back():
    b = virtual(401)
    switches = FaultSwitches(b.node)
    for on, data in ((True, "005001"), (False, "000000")):
        b.seen.clear()
        switches.set(fault("device_error"), on, b.now)
        b.collect()
        assert [frame.data[:3].hex() for _, frame in b.seen if frame.can_id == 0x085] == [data]


@pytest.mark.parametrize(("number", "name"), [(0, "input_stuck"), (401, "drive_fault")])
def test_a_fault_of_inputs_is_refused_by_a_drive_and_one_of_axes_by_a_module(number, name):
    node = virtual(number).node if number else bench().node
    switches = node.fault_switches or FaultSwitches(node)
    for act in (lambda: switches.set(name, True, 0), lambda: switches.schedule(name)):
        with pytest.raises(ConfigError, match=f"{name} is possible only on "):
            act()


def test_outputs_that_are_overloaded_are_off_at_the_terminals_and_reported():
    b = virtual(401)
    switches = FaultSwitches(b.node)

    def lamp():
        return next(item.value for item in b.node.function.describe() if item.name == "do0")

    def emergency():
        b.collect()
        return [frame.data[:3].hex() for _, frame in b.seen if frame.can_id == 0x085][-1]

    b.start()
    b.put(0x205, b"\xff\x00")
    switches.set(fault("output_overload"), True, b.now)
    assert (lamp(), emergency()) == (0.0, "102303")
    assert b.number(0x6200, 1) == 0xFF  # what stands commanded
    switches.set("output_overload", False, b.now)
    assert (lamp(), emergency()) == (1.0, "000000")


def test_outputs_are_overloaded_where_there_are_some():
    with pytest.raises(ConfigError, match="only on devices other than drives, with outputs"):
        FaultSwitches(virtual(406).node).set("output_overload", True, 0)


NEW = whole_program(b"a new program" * 200)


@pytest.fixture
def programmed():
    return Faulty(make_device(program_od(), 5))


def cleared(b):
    for command in (0, 3):
        b.write(0x1F51, command, 1, size=1)
        b.on(0.5)
    return b


def flash(b):
    return int.from_bytes(b.read(0x1F57, 1), "little")


def test_a_program_that_is_lost_leaves_the_boot_loader_and_returns(programmed):
    programmed.set(fault("program_lost"))
    programmed.on(0.1)
    assert (programmed.read(0x1000), programmed.read(0x1F51, 1), flash(programmed)) == (bytes(4), b"\0", 1 << 1)
    programmed.set("program_lost", False)
    programmed.on(0.1)
    assert (programmed.read(0x1000)[:2], programmed.read(0x1F51, 1)) == (b"\x92\1", b"\1")


def test_a_program_that_was_loaded_meanwhile_is_kept(programmed):
    programmed.set("program_lost")
    programmed.on(0.1)
    cleared(programmed).node.store.download(0x1F50, 1, NEW)
    programmed.set("program_lost", False)
    programmed.on(0.1)
    assert (programmed.node.program.runs, programmed.node.program.image) == (True, NEW)


@pytest.mark.parametrize(("name", "status"), [(fault("program_damaged"), 3 << 1), (fault("flash_fails"), 5 << 1)])
def test_a_program_that_is_not_written_as_it_is_never_runs(programmed, name, status):
    programmed.set(name)
    with contextlib.suppress(SdoServerAbort):
        cleared(programmed).node.store.download(0x1F50, 1, NEW)
    programmed.on(0.2)
    assert (flash(programmed), programmed.read(0x1F56, 1)) == (status, bytes(4))
    programmed.set(name, False)
    cleared(programmed).node.store.download(0x1F50, 1, NEW)
    programmed.on(0.2)
    assert flash(programmed) == 0


def test_a_flash_that_is_slow_is_busy_for_long(programmed):
    programmed.set(fault("flash_slow"))
    assert flash(cleared(programmed)) == 1
    programmed.on(11.0)
    assert flash(programmed) == 1
    programmed.on(1.0)
    assert flash(programmed) == 0


def test_a_drive_without_a_program_area_has_no_such_faults():
    with pytest.raises(ConfigError, match=r"only on devices with a loadable program \(0x1F51\)"):
        bench().set("flash_slow")


@pytest.mark.parametrize("method", [17, 35])
@pytest.mark.parametrize("speed", [0, 2000])
def test_homing_without_end_on_a_tmcm_1270(method, speed):
    """Whose speeds are 0 until they are written."""
    b = Faulty(tmcm())
    for index, value in ((0x6099, 1), (0x6099, 2), (0x609A, 0)):
        b.write(index, speed, value)
    b.write(0x6098, method)
    b.set("homing_endless")
    b.enable(6)
    b.control(0x1F)
    b.on(100)
    assert b.statusword & 0x3400 == 0
    b.control(0x0F)
    b.on(1)
    b.set("homing_endless", False)
