"""The import bench: commands are timed as a user starts them; one that fails is no figure."""

import os
import sys

import pytest
from canopen_control_bench.imports import BARE, seconds_of

from canopen_control.errors import CanopenError

pytestmark = pytest.mark.process


def test_a_command_that_waits_takes_longer_than_nothing():
    environment = {**os.environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}
    slow = (sys.executable, "-c", "import time; time.sleep(0.3)")
    assert seconds_of(slow, environment, 1) - seconds_of(BARE, environment, 1) > 0.1


def test_a_command_that_fails_is_no_figure():
    with pytest.raises(CanopenError, match="ended with 3"):
        seconds_of((sys.executable, "-c", "raise SystemExit(3)"), os.environ, 1)
