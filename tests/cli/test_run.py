import argparse
import io
import os
import threading
from types import SimpleNamespace

import pytest

from canopen_control.cli import demo, run
from canopen_control.cli.main import main
from canopen_control.cli.run import Announcer, _options, add_arguments, read_setup, run_shared
from canopen_control.client import find_robots
from canopen_control.errors import ConfigError
from canopen_control.host import fork
from canopen_control.host.fork import allow_forks
from canopen_control.master.event_log import Event
from canopen_control.od import eds


def arguments(*words):
    parser = argparse.ArgumentParser()
    run.add_arguments(parser)
    return parser.parse_args(["--world", "hall.yml", *words])


@pytest.mark.parametrize("words", [["--can", "vcan0"], ["--real"], ["--name", "a"], ["--plant", "a.yml"]])
def test_what_the_file_specifies_is_refused(words):
    with pytest.raises(ConfigError, match=f"{words[0]} is for a single robot"):
        run_shared(arguments(*words))


def test_each_robot_gets_the_options_of_all():
    options = _options(arguments("--for", "3", "--strict", "--no-flight-recorder"))
    assert options == ["--strict", "--no-flight-recorder", "--for", "3"]


def test_a_file_that_is_not_there_is_reported(tmp_path):
    args = arguments()
    args.world = str(tmp_path / "gone.yml")
    with pytest.raises(ConfigError, match=r"gone\.yml"):
        run.run(args)


def parse(*arguments):
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return parser.parse_args(arguments)


def test_an_argument_that_names_a_world_is_for_physics_and_counts_as_the_option(tmp_path, capsys):
    hall = tmp_path / "hall.sdf"
    hall.write_text('<sdf version="1.9"><world name="hall"/></sdf>')
    word = f"world:={hall}"
    assert read_setup(parse("robby", word, "--physics")).world == hall
    assert read_setup(parse("robby", "--physics", "--world", str(hall))).world == hall
    for arguments, text in (
        (["robby", word], f"{word} requires physics; add --physics"),
        (["robby", "--physics", word, "--world", "o.yml"], f"{word} contradicts --world o.yml; omit one of them"),
    ):
        assert main(["run", *arguments]) == 2
        assert text in capsys.readouterr().err


@pytest.mark.process
def test_a_run_on_mock_hardware_ends_with_0_and_leaves_no_socket(capsys):
    assert main(["run", "robby", "--mock", "--for", "0.3"]) == 0
    output = capsys.readouterr().out
    assert "robby runs" in output
    assert find_robots() == []


@pytest.mark.process
def test_a_run_on_virtual_drives_in_this_process(capsys):
    assert main(["run", "robby", "--can", "memory:run", "--for", "0.3"]) == 0
    output = capsys.readouterr().out
    assert "node 3 (left_drive): operational" in output
    assert "has stopped" in output


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nobody"], "nobody"),
        (["robby", "--controller", "nobody"], "nobody"),
        (["robby", "--real", "--mock"], "--real"),
        (["robby", "--as", "a/b"], "a/b"),
        (["robby", "--mock", "--teleop"], "requires the page; add --view"),
        (["robby", "--kernel-sync"], "--kernel-sync: the kernel cannot send SYNC on local:robby"),
        (["robby", "--kernel-sync", "--can", "pcan:PCAN_USBBUS1"], "a SocketCAN interface such as --can vcan0"),
        (["robby", "--kernel-sync", "--mock"], "--kernel-sync: the robot uses no bus"),
        (["robby", "--mock", "--cpu", "4000"], "--cpu 4000: choose a processor that this process may use:"),
        (["robby", "--can", "nonsense"], "nonsense"),
        (["robby", "--world", "hall.yml"], "--world requires physics"),
        (["robby", "--physics", "--world", "none.sdf"], "none.sdf: cannot be read: No such file or directory"),
        (["robby", "world:=none.sdf"], "world:=none.sdf: file none.sdf does not exist"),
        (["robby", "--like", "emo"], "no personality 'emo' (did you mean 'elmo'?)"),
        (["robby", "--like", "elmo", "--mock"], "--like is for virtual drives that this program starts"),
        (["robby", "--like", "elmo", "--can", "vcan9", "--no-drives"], "--like is for virtual drives"),
        (["robby", "--physics", "--mock"], "omit --mock"),
        (["robby", "--physics", "--no-drives"], "omit --no-drives"),
        (["robby", "--physics", "--can", "memory:x"], "use --can local:NAME"),
        (["robby", "--plant", "none.yml", "--mock"], "omit --mock"),
        (["robby", "--plant", "none.yml", "--no-drives"], "omit --no-drives"),
        (["robby", "--plant", "none.yml", "--physics"], "omit --physics"),
        (["robby", "--plant", "none.yml", "--can", "memory:x"], "use --can local:NAME"),
        (["robby", "--plant", "none.yml"], "none.yml"),
        (["robby", "--can", "left=can0"], "left"),
        (["robby", "--mock", "--namespace", "two"], "requires the ROS bridge; add --ros"),
        (["robby", "--mock", "--ros-args", "-p", "rate:=20.0"], "requires the ROS bridge; add --ros"),
        ([], "bundled robot"),
    ],
)
def test_an_error_of_the_user_is_one_sentence_and_exit_code_2(capsys, arguments, words):
    assert main(["run", *arguments]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert "Traceback" not in error
    assert find_robots() == []


@pytest.mark.process
def test_a_channel_that_is_not_there_is_exit_code_2_and_suggests_what_to_type(capsys):
    assert main(["run", "robby", "--can", "can7", "--real"]) == 2
    assert "can7" in capsys.readouterr().err


@pytest.mark.parametrize("verb", [run, demo])
def test_the_bridge_gets_its_namespace_and_all_that_comes_after_ros_args(verb):
    parser = argparse.ArgumentParser()
    verb.add_arguments(parser)
    ours, theirs = ["--ros", "--namespace", "two"], ["--ros-args", "-r", "cmd_vel:=drive", "--params-file", "a b"]
    assert run.bridge_arguments(parser.parse_args([*ours, *theirs])) == ("--namespace", "two", *theirs)
    assert run.bridge_arguments(parser.parse_args(["--ros"])) == ()


def test_real_time_is_off_or_has_a_priority_below_that_of_interrupts(capsys):
    assert parse("robby").realtime is None
    assert parse("robby", "--realtime").realtime == 40
    assert parse("robby", "--realtime", "70").realtime == 70
    for wrong in ("0", "100", "high"):
        with pytest.raises(SystemExit) as ended:
            parse("--realtime", wrong)
        assert ended.value.code == 2
        assert "1 to 99" in capsys.readouterr().err


def test_ros_is_off_unless_it_is_asked_for():
    assert parse("robby").ros is False
    assert parse("robby", "--ros").ros is True
    assert parse("robby", "--no-ros").ros is False


def test_the_flight_recorder_is_on_unless_it_is_switched_off():
    assert parse("robby").flight_recorder
    assert not parse("robby", "--no-flight-recorder").flight_recorder


class Listener:
    def __init__(self):
        self.lines = []

    def put(self, line, *, token=False):
        self.lines.append(line)


def test_of_many_nodes_it_is_reported_how_many_have_booted():
    many, few = Listener(), Listener()
    for listener, nodes in ((many, 5), (few, 2)):
        session = SimpleNamespace(robot=SimpleNamespace(nodes=dict.fromkeys(range(nodes))))
        tell = run._EventPrinter(listener, session, table=False, prefix="").event
        for name in ("a", "b", "a"):
            tell(Event(0, "ready", name, f"{name} is operational"))
        tell(Event(0, "active", "", "x is active"))
    assert many.lines == [
        "a is operational (1 of 5 nodes)",
        "b is operational (2 of 5 nodes)",
        "a is operational (2 of 5 nodes)",
        "x is active",
    ]
    assert few.lines == ["a is operational", "b is operational", "a is operational", "x is active"]


def test_what_forks_share_is_taken_back_at_the_end_of_a_run_that_does_not_begin(monkeypatch, capsys):
    shared = []

    def prepare(*_arguments, **_options):
        allow_forks()
        eds.keep_files()
        shared.append((fork._allowed, eds._cache))
        raise ConfigError("not today")

    monkeypatch.setattr(run, "_prepare", prepare)
    assert main(["run", "robby"]) == 2
    assert shared == [(True, {})]
    assert (fork._allowed, eds._cache) == (False, None)
    assert "not today" in capsys.readouterr().err


# -- announcer


def test_lines_come_in_order_and_all_of_them_before_the_end():
    stream = io.StringIO()
    announcer = Announcer(stream)
    for number in range(100):
        announcer.put(f"line {number}")
    announcer.close()
    assert stream.getvalue().splitlines() == [f"line {number}" for number in range(100)]


def test_a_reader_that_stalls_blocks_no_other():
    class Stalled(io.StringIO):
        def write(self, text):
            released.wait(60)
            return len(text)

    released = threading.Event()
    announcer = Announcer(Stalled())
    for _ in range(1500):
        announcer.put("x")
    assert announcer.dropped > 0
    released.set()
    announcer.close()


def test_a_reader_that_is_gone_is_not_an_error():
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as stream:
        announcer = Announcer(stream)
        announcer.put("nobody hears this")
        announcer.close()
        assert announcer.dropped == 1
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
