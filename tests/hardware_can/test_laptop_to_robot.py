"""The commands of docs/guide/hardware.md for a CAN card, in their order, with drives at the other one."""

import pytest
from support.guest import LEFT, RIGHT, ip, scaled
from support.laptop_to_robot import needs_a_card, runnable, way_commands

pytestmark = [pytest.mark.hardware, pytest.mark.timeout(600)]
SAYS = {
    "bus up": ["ip link set can0 up   # bring it up"],
    "bus status": ["can0: can, up, ERROR-ACTIVE, 1000000 bit/s, transmit errors 0, receive errors 0"],
    "scan --can": ["left_drive"],
    "preflight robby": [
        "ok    bit rate  1000000 bit/s, and 1000000 in bus.yml\n",
        "ok    link      can0 is up and ERROR-ACTIVE\n",
        "robby has passed; run it with --real",
    ],
    "run robby": ["robby runs"],
}


def test_the_way_ends_with_the_robot_on_real_drives(stage, robby):
    for name in ("can0", "can1"):
        ip("link", "set", name, "down")
    assert stage.call("bus", "up", "can1", "--bitrate", 1_000_000, seconds=60).wait() == 0
    for node_id in (LEFT, RIGHT):
        stage.start("drive", "--node-id", node_id, "--eds", "TMCM-1270.eds", "--can", "can1").until(
            "ready on", scaled(10)
        )
    commands = [words for words in way_commands() if needs_a_card(words)]
    assert [" ".join(words[:2]) for words in commands] == list(SAYS), "each once, and in this order"
    for words in commands:
        program = stage.call(*runnable(words, robby, scaled(1)), seconds=240)
        assert program.wait() == 0, program
        assert all(text in program.out for text in SAYS[" ".join(words[:2])]), program
    assert "limited" not in program.out, "the preflight has passed"
