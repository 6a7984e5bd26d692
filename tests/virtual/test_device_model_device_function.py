"""Which function a virtual device has: by its dictionary, and none where it is a drive."""

import functools
import subprocess
import sys
from dataclasses import replace

import pytest
from support.eds import DEVIATIONS, MALFORMED
from support.iomodule import EDS_TEXT
from support.robots import dictionary_of
from support.virtualbench import Bench, servo

from canopen_control.cia301.nmt import NmtState
from canopen_control.data_files import data_names, data_path
from canopen_control.errors import EdsError
from canopen_control.od.eds import parse_eds, read_eds
from canopen_control.profiles import Profile, profile_of
from canopen_control.virtual.device import make_device
from canopen_control.virtual.io_device import IoDevice


def test_a_module_has_the_function_of_its_profile_and_a_drive_has_none():
    module = make_device(dictionary_of(data_path("eds", "generic_cia401.eds")), 5)
    assert isinstance(module.function, IoDevice)
    assert module.drives == {}
    assert servo().function is None


@pytest.mark.process
def test_a_drives_process_starts_without_the_functions_of_other_devices():
    code = (
        "import sys; from canopen_control.virtual.device import make_device; "
        "from canopen_control.data_files import data_path; make_device(data_path('eds', 'TMCM-1270.eds'), 3); "
        "print('canopen_control.virtual.io_device' in sys.modules)"
    )
    message = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert message.stdout.strip() == "False"


# -- every file that is of no drive

NODE = 5
PROFILES = {"generic_cia401.eds": Profile.IO, "generic_cia404.eds": Profile.MEASURING,
            "generic_cia406.eds": Profile.ENCODER, "generic_cia410.eds": Profile.INCLINOMETER,
            "generic_cia418.eds": Profile.BATTERY, "generic_cia419.eds": Profile.CHARGER}  # fmt: skip


@functools.cache
def files():
    """Return the dictionaries of all files of the tests and the package that are of no drive, by name."""
    result = {"an I/O module with outputs alone": parse_eds(EDS_TEXT.encode(), NODE).od}
    for path in sorted([*MALFORMED.glob("*.eds"), *DEVIATIONS.glob("*.eds")]):
        try:
            result[path.name] = read_eds(path, NODE).od
        except EdsError:
            continue
    result |= {
        name: dictionary_of(data_path("eds", name)).for_node(NODE)
        for name in data_names("eds")
        if name.endswith(".eds")
    }
    for name in PROFILES:  # as half of all files are
        unnamed = result[name].for_node(NODE)
        unnamed.add(replace(unnamed[0x1000, 0], default=0))
        result[f"{name} without a device type"] = unnamed
    return {name: od for name, od in result.items() if profile_of(od) is not Profile.DRIVE}


def test_there_are_many_of_them():
    assert len(files()) > 40
    assert {profile_of(files()[name]) for name in PROFILES} == set(PROFILES.values())


@pytest.mark.parametrize("name", files())
def test_it_boots_answers_and_shows_what_is_set(name):
    od = files()[name]
    bench = Bench(make_device(od, NODE)).on(0.1)
    assert [frame.data for _, frame in bench.seen if frame.can_id == 0x700 + NODE] == [b"\0"]
    if (0x1000, 0) in od:
        assert bench.number(0x1000) == (od[0x1000, 0].value or 0)
    bench.start()
    bench.on(0.5)
    function = bench.node.function
    assert bench.node.nmt.state is NmtState.OPERATIONAL
    assert (function is None) == (profile_of(od) is Profile.NONE)
    if function is not None:
        inputs = [item.name for item in function.describe() if not item.output]
        function.set_signals(dict.fromkeys(inputs, 1.0), bench.now)
        bench.on(0.5)
        assert all(item.value == pytest.approx(1.0, abs=1.1) for item in function.describe() if not item.output)


@pytest.mark.parametrize("name", PROFILES)
def test_what_a_file_is_of_is_known_without_its_device_type(name):
    assert profile_of(files()[f"{name} without a device type"]) is PROFILES[name]
