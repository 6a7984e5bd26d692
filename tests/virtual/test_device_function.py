"""Which function a virtual device has: by its dictionary, and none where it is a drive."""

import subprocess
import sys

import pytest
from support.robots import dictionary_of
from support.virtualbench import servo

from canopen_control.data_files import data_path
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
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "False"
