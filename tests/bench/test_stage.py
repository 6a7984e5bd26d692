"""The stage: programs in folders of their own, ended when it is left; their complaints are told."""

import os

import pytest
from canopen_control_bench.stage import stage
from support.host import eventually

from canopen_control.bus.local import ask_hub
from canopen_control.errors import CanopenError
from canopen_control.rpc.messages.hub import GetHubStatus

pytestmark = pytest.mark.process


def there(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_drives_and_hub_are_gone_afterwards_and_the_environment_is_as_before():
    before = dict(os.environ)
    with stage() as played:
        assert os.environ["XDG_RUNTIME_DIR"] == str(played.folder)
        drives = played.drives("local:stage", "2-3")
        hub = ask_hub("stage", GetHubStatus()).pid
        assert there(drives.pid)
    assert drives.process.poll() is not None
    assert dict(os.environ) == before
    assert not played.folder.exists()
    assert eventually(lambda: not there(hub))


def test_ros_is_played_where_the_users_robot_does_not_hear_it_and_his_domain_comes_back(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "7000")
    with stage():
        assert 0 < int(os.environ["ROS_DOMAIN_ID"]) <= 100
    assert os.environ["ROS_DOMAIN_ID"] == "7000"


def test_a_program_that_says_nothing_is_ended():
    with stage() as played:
        silent = played.slaves("local:stage", 2, 1)
        with pytest.raises(CanopenError, match=r"canopen_control_bench\.slaves ended with -9"):
            silent.line(0.2)


def test_a_program_that_ends_says_why():
    with stage() as played, pytest.raises(CanopenError, match="XXX"):
        played.drives("local:stage", "XXX")
