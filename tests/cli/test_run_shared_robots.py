import argparse

import pytest

from canopen_control.cli import run
from canopen_control.cli.run import _options, run_shared
from canopen_control.errors import ConfigError


def arguments(*words):
    parser = argparse.ArgumentParser()
    run.add_arguments(parser)
    return parser.parse_args(["--world", "hall.yml", *words])


@pytest.mark.parametrize("words", [["--can", "vcan0"], ["--real"], ["--name", "a"], ["--plant", "a.yml"]])
def test_what_the_file_says_is_refused(words):
    with pytest.raises(ConfigError, match=f"{words[0]}: without a robot --world runs all"):
        run_shared(arguments(*words))


def test_each_robot_gets_the_options_of_all():
    given = _options(arguments("--for", "3", "--strict", "--no-flight-recorder"))
    assert given == ["--strict", "--no-flight-recorder", "--for", "3"]


def test_a_file_that_is_not_there_is_told(tmp_path):
    args = arguments()
    args.world = str(tmp_path / "gone.yml")
    with pytest.raises(ConfigError, match=r"gone\.yml"):
        run.run(args)
