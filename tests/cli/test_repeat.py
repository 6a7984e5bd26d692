import argparse
import threading

import pytest
from support.host import eventually
from support.mockrobot import running

from canopen_control.cli.repeat import PERIOD_S, add_repeat_arguments, send
from canopen_control.errors import RemoteError


def parse(*arguments):
    parser = argparse.ArgumentParser()
    add_repeat_arguments(parser)
    return parser.parse_args(arguments)


def test_it_repeats_faster_than_any_usual_timeout():
    assert PERIOD_S <= 0.25


def test_for_and_once_exclude_each_other(capsys):
    with pytest.raises(SystemExit) as caught:
        parse("--for", "1", "--once")
    assert caught.value.code == 2
    assert "not allowed" in capsys.readouterr().err


def test_zeros_are_sent_even_if_the_robot_refuses_in_between():
    """The finally clause is what stops the wheels: a refusal in the middle may not skip it."""
    with running() as robot:
        params = {"controller": "robby_forward_controller", "values": [1.0, 1.0]}
        zeros = {"controller": "robby_forward_controller", "values": [0.0, 0.0]}
        timer = threading.Timer(0.15, params.update, [{"values": [1.0]}])
        timer.start()
        with pytest.raises(RemoteError, match="1"):
            send(parse("--for", "2"), "command", params, zeros)
        timer.join()
        assert eventually(lambda: robot.status()["joints"]["left_wheel_joint"]["command"] == 0.0)
