"""The adapter of the how-to page, installed as a separate package, transfers the answers of a virtual drive."""

import socket

import pytest
from support.documents import install, run_python


def free_ports():
    with socket.socket(type=socket.SOCK_DGRAM) as one, socket.socket(type=socket.SOCK_DGRAM) as other:
        one.bind(("127.0.0.1", 0))
        other.bind(("127.0.0.1", 0))
        return one.getsockname()[1], other.getsockname()[1]


@pytest.mark.process
def test_a_drive_at_its_other_end_answers(stage, tmp_path):
    site = tmp_path / "site"
    install(site, "my_adapter")
    here, there = free_ports()
    channel = f"udp_can:{there}-{here}"
    drive = stage.start("drive", "--node-id", 3, "--eds", "TMCM-1270.eds", "--can", channel, PYTHONPATH=str(site))
    drive.until("ready on")
    words = ["-m", "canopen_control", "sdo", "read", "3", "0x1008", "--can", f"udp_can:{here}-{there}"]
    assert '"TMCM-1270"' in run_python(*words, folder=stage.place, PYTHONPATH=str(site))
