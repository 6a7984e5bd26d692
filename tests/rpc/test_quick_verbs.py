import subprocess
import sys

import pytest

from canopen_control.rpc.quick_verbs import state_name

_FRESH = """
import sys, threading
{before}
from canopen_control.rpc.quick_verbs import import_msgspec
import_msgspec()
assert ("msgspec" in sys.modules) is {imported}
import canopen_control.rpc.wire
assert ("typing_extensions" in sys.modules) is {slow}
assert ("platform" in sys.modules) <= {slow}
import platform, typing_extensions
assert platform.python_version() and typing_extensions.TypedDict
print(canopen_control.rpc.wire.text_of([1]).decode())
"""
_WAITING_THREAD = "over = threading.Event(); threading.Thread(target=over.wait, daemon=True).start()"


@pytest.mark.process
@pytest.mark.parametrize(
    ("before", "imported", "slow"),
    [("", True, False), (_WAITING_THREAD, False, True), ("import typing_extensions", False, True)],
    ids=["alone", "beside a thread", "where it is needed anyway"],
)
def test_msgspec_is_imported_without_a_slow_module_unless_other_code_might_need_it(before, imported, slow):
    code = _FRESH.format(before=before, imported=imported, slow=slow)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "[1]\n", "")


# -- state name


@pytest.mark.parametrize(
    ("state", "name"), [(None, "-"), ("OPERATION_ENABLED", "OPERATION ENABLED"), ("PRE_OPERATIONAL", "PRE OPERATIONAL")]
)
def test_a_state_is_written_as_in_the_standard(state, name):
    assert state_name(state) == name
