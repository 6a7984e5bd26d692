"""The commands of docs/guide/hardware.md for the laptop, in their order, on this kernel."""

import pytest
from support.guest import ip, scaled
from support.laptop_to_robot import needs_a_card, runnable, way_commands

pytestmark = pytest.mark.socketcan
SAYS = {"bus": "vcan0 up   # bring it up", "run": "robby has stopped, its drives are disabled"}


def test_the_way_begins_on_the_laptop_without_and_with_kernel_can(stage, robby):
    commands = [words for words in way_commands() if not needs_a_card(words)]
    assert [" ".join(words) for words in commands] == ["run robby", "bus up vcan0", "run robby --can vcan0"]
    ip("link", "del", "vcan0")
    for words in commands:
        program = stage.call(*runnable(words, robby, scaled(1)), seconds=scaled(20))
        assert program.wait() == 0, program
        assert SAYS[words[0]] in program.out
