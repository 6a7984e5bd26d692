"""The verb firmware; and a plain client of another library with our drive."""

import json
import threading
import time
import zlib

import canopen
import pytest
from support.host import TIMEOUT_S, eventually
from support.onbus import TMCM, OnBus
from support.programs import PROGRAM_EDS

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.cli.main import main
from canopen_control.data_files import data_path
from canopen_control.virtual.communication_objects import whole_program
from canopen_control.virtual.fault_table import FaultSwitches

NEW = whole_program(b"version two " * 400)


@pytest.fixture
def bus(private_folders):
    with OnBus("memory:firmware", {3: PROGRAM_EDS, 4: TMCM}) as devices:
        devices.options = ["--can", "memory:firmware"]
        devices.eds = PROGRAM_EDS
        yield devices


@pytest.fixture
def program(tmp_path):
    path = tmp_path / "drive.bin"
    path.write_bytes(NEW)
    return str(path)


def test_a_program_is_loaded_and_runs(bus, program, capsys):
    assert main(["firmware", "3", program, *bus.options, "--eds", bus.eds]) == 0
    area = bus.nodes[3].program
    assert (area.runs, area.image) == (True, NEW)
    assert capsys.readouterr().out.endswith(f"-> 0x{zlib.crc32(NEW[:-4]):08X}\n")


def test_without_an_eds_and_in_the_loader_too(bus, program, capsys):
    assert main(["sdo", "write", "3", "1F51:1", "0", "--type", "u8", *bus.options]) == 0
    capsys.readouterr()
    code = main(["firmware", "3", program, *bus.options, "--json", "--expect", hex(zlib.crc32(NEW[:-4]))])
    assert code == 0, capsys.readouterr().err
    reported = json.loads(capsys.readouterr().out)
    assert (reported["program"], reported["bytes"], reported["tries"], reported["notes"]) == (1, len(NEW), 1, [])
    assert (reported["old_date"], reported["new_date"]) == (None, None)
    assert bus.nodes[3].program.image == NEW


@pytest.mark.parametrize(("expected", "code"), [("2025-01-25T12:00:00", 0), ("2025-01-26", 1)])
def test_the_date_of_a_program_is_reported_and_compared(bus, tmp_path, capsys, expected, code):
    path = tmp_path / "dated.bin"
    path.write_bytes(whole_program(b"dated", days=15_000, milliseconds=43_200_000))
    assert main(["firmware", "3", str(path), *bus.options, "--eds", bus.eds, "--expect-date", expected]) == code
    output = capsys.readouterr()
    if code:
        assert "the program runs, and reports 2025-01-25 12:00:00 (0x1F52); 2025-01-26 was expected" in output.err
    else:
        assert output.out.endswith(" of 2025-01-25 12:00:00\n")
    assert bus.nodes[3].program.runs


@pytest.mark.parametrize("text", ["yesterday", "2025-13-01", "2025-01-25T25:00"])
def test_what_is_not_a_date_is_reported(program, capsys, text):
    with pytest.raises(SystemExit):
        main(["firmware", "3", program, "--expect-date", text])
    assert "is not a date: 2026-11-21" in capsys.readouterr().err


def test_a_flash_that_fails_is_reported_and_the_same_command_repairs_it(bus, program, capsys):
    switches = FaultSwitches(bus.nodes[3])
    bus.call(lambda: switches.set("flash_fails", True, time.monotonic_ns()))
    assert main(["firmware", "3", program, *bus.options, "--eds", bus.eds]) == 1
    assert "flash write error" in capsys.readouterr().err
    bus.call(lambda: switches.set("flash_fails", False, time.monotonic_ns()))
    assert main(["firmware", "3", program, *bus.options, "--eds", bus.eds]) == 0


def test_a_node_without_program_download_is_reported(bus, program, capsys):
    assert main(["firmware", "4", program, *bus.options, "--eds", TMCM]) == 2
    assert "cannot be loaded over CANopen: 0x1F51:01: abort 0x06020000" in capsys.readouterr().err


def test_another_product_an_enabled_drive_and_bad_files_send_nothing(bus, program, tmp_path, capsys):
    before = bus.nodes[3].program.image
    assert main(["firmware", "3", program, *bus.options, "--eds", TMCM]) == 2
    assert "node 3 does not match its EDS: vendor 0x00000286 in the EDS" in capsys.readouterr().err
    empty = tmp_path / "empty.bin"
    empty.touch()
    eds = str(data_path("eds", TMCM))
    for name, why in (
        (str(empty), "is empty"),
        (str(tmp_path / "gone.bin"), "cannot be read"),
        (eds, "is an EDS or DCF, not a program"),
    ):
        assert main(["firmware", "3", name, *bus.options]) == 2
        assert why in capsys.readouterr().err
    bus.call(lambda: bus.nodes[3].store.on_read(0x6041, 0, lambda: 0x0637))
    assert main(["firmware", "3", program, *bus.options, "--eds", bus.eds]) == 1
    assert "node 3 is enabled" in capsys.readouterr().err
    assert bus.nodes[3].program.image == before
    assert bus.nodes[3].program.runs


def test_a_damaged_file_is_reported_and_the_right_one_repairs_it(bus, program, tmp_path, capsys):
    damaged = tmp_path / "damaged.bin"
    damaged.write_bytes(NEW[:-1] + b"?")
    assert main(["firmware", "3", str(damaged), *bus.options, "--eds", bus.eds]) == 1
    error = capsys.readouterr().err
    assert "format or CRC error" in error
    assert "repeat the command to start again" in error
    assert main(["firmware", "3", program, *bus.options, "--eds", bus.eds]) == 0
    assert "is in its boot-loader" in capsys.readouterr().err


@pytest.mark.process
@pytest.mark.parametrize(
    ("image", "blocks", "buffered"), [(NEW, True, 889), (whole_program(b"version two " * 100), False, 1024)]
)
def test_a_plain_client_of_another_library_loads_a_program_too(private_folders, image, blocks, buffered):
    """The sequence of Zephyr's runner: stop, clear, poll the flash, download by blocks or segments, poll, start."""
    with OnBus("local:plain", {3: PROGRAM_EDS}) as bus:
        load_as_zephyr_does("plain", str(data_path("eds", PROGRAM_EDS)), image, blocks, buffered)
        assert (bus.nodes[3].program.runs, bus.nodes[3].program.image) == (True, image)


def load_as_zephyr_does(channel, eds, image, blocks, buffered):
    network = canopen.Network()
    network.connect(interface="canopen_control", channel=channel)
    try:
        node = network.add_node(3, eds)
        node.sdo.RESPONSE_TIMEOUT = TIMEOUT_S
        booted = threading.Semaphore(0)
        network.subscribe(0x703, lambda _id, data, _time: data == b"\0" and booted.release())
        network.nmt.send_command(NmtCommand.ENTER_PRE_OPERATIONAL)
        control, flash = node.sdo[0x1F51][1], node.sdo[0x1F57][1]
        control.raw = 0
        assert booted.acquire(timeout=TIMEOUT_S)
        assert (control.raw, node.sdo[0x1000].raw) == (0, 0)
        control.raw = 3
        wait_for_flash(flash)
        with node.sdo[0x1F50][1].open("wb", buffering=buffered, size=len(image), block_transfer=blocks) as stream:
            stream.write(image)
        wait_for_flash(flash)
        assert node.sdo[0x1F56][1].raw == zlib.crc32(image[:-4])
        control.raw = 1
        assert booted.acquire(timeout=TIMEOUT_S)
        assert control.raw == 1
    finally:
        network.disconnect()


def wait_for_flash(flash):
    assert eventually(lambda: not flash.raw & 1)
    assert flash.raw == 0
