import errno
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from canopen_control.cli.main import main
from canopen_control.cli.verbs import MAX_USED, VERBS
from canopen_control.errors import ControlError
from canopen_control.version import PURE, TO_COMPILE, __version__, build


def test_the_help_fits_a_terminal_and_names_the_most_used_verbs(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["--help"])
    assert caught.value.code == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 36
    assert max(map(len, lines)) <= 80
    shown = {line.split()[0] for line in lines if line.startswith("  ")}
    assert shown == set(MAX_USED)
    assert lines[-1].endswith("canopen-control help --all")


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_a_help_with_an_example(verb, capsys):
    with pytest.raises(SystemExit) as caught:
        main([verb, "--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out.split("example: canopen-control ")[1]
    assert re.search(rf"^(.*canopen-control )?{verb} ?", text, re.MULTILINE)


def test_an_unknown_verb_is_a_usage_error(capsys):
    assert main(["xyzzy"]) == 2
    assert capsys.readouterr().err == "canopen-control: no verb 'xyzzy'; canopen-control help --all lists every verb\n"
    assert main(["statsu"]) == 2
    assert capsys.readouterr().err == "canopen-control: no verb 'statsu'; did you mean status?\n"
    assert main(["fault-reset", "all"]) == 2
    error_output = capsys.readouterr().err
    assert error_output == "canopen-control: no verb 'fault-reset'; did you mean canopen-control axis fault-reset?\n"


def test_nothing_at_all_prints_the_help_and_is_a_usage_error(capsys):
    assert main([]) == 2
    assert "canopen-control help --all" in capsys.readouterr().out


def test_the_version_is_the_packages(capsys):
    with pytest.raises(SystemExit):
        main(["--version"])
    how = f"; {TO_COMPILE}" if build() == PURE else ""
    assert capsys.readouterr().out == f"canopen-control {__version__} ({build()}{how})\n"


def test_an_error_of_the_user_is_one_sentence_and_exit_code_2(capsys):
    assert main(["status"]) == 2
    error = capsys.readouterr().err
    assert error == "canopen-control: no robot is running; start one: canopen-control run robby\n"


@pytest.mark.parametrize("verb", [["scan"], ["sdo", "read", "3", "0x1000"], ["nmt", "start", "3"], ["trace"]])
def test_a_verb_for_a_bare_bus_names_its_option_if_no_robot_runs(verb, private_folders, capsys):
    assert main(verb) == 2
    start = "canopen-control: no robot is running; start one: canopen-control run robby"
    assert capsys.readouterr().err == f"{start}, or give the channel of a bus without a robot, as in --can can0\n"


UNKNOWN = [
    "axis enable nosuch",
    "nmt preop nosuch",
    "sdo read nosuch 0x1000",
    "command nosuch 1",
    "twist nosuch 0.1 0",
    *(f"controller {step} nosuch" for step in ("load", "configure", "activate", "deactivate", "unload")),
    "controller switch --activate nosuch",
]


def test_a_name_that_the_robot_does_not_have_is_a_usage_error(mock_robot, capsys):
    for words in UNKNOWN:
        assert main(words.split()) == 2, words
        error_output = capsys.readouterr().err
        assert error_output.count("\n") == 1, (words, error_output)


@pytest.mark.rest
def test_what_the_robot_refuses_for_another_reason_is_not(mock_robot, capsys):
    assert main(["controller", "unload", "robby_forward_controller"]) == 1
    assert "is active; deactivate it" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "advice", "shown"),
    [
        (["--name", "left"], "enable it: canopen-control axis enable all", " (with --name left)"),
        (["--name=left"], "enable it: canopen-control axis enable all", " (with --name left)"),
        ([], "enable it: canopen-control axis enable all", ""),
        (["--name", "left"], "end it: canopen-control shutdown --name left", ""),
        (["--name", "left"], "start one: canopen-control run robby --as left", ""),
        (["--name", "left"], "wait for left_drive", ""),
    ],
)
def test_the_advice_of_a_named_robot_has_its_name(monkeypatch, capsys, options, advice, shown):
    def run(_args):
        raise ControlError(f"the drives are not enabled; {advice}")

    monkeypatch.setattr("canopen_control.cli.shutdown.run", run)
    assert main(["shutdown", *options]) == 1
    assert capsys.readouterr().err == f"canopen-control: the drives are not enabled; {advice}{shown}\n"


def test_a_fault_of_the_program_is_a_sentence_and_a_traceback_only_where_asked(monkeypatch, capsys):
    def run(_args):
        raise ZeroDivisionError("by accident")

    monkeypatch.setattr("canopen_control.cli.check.run", run)
    assert main(["check", "robby"]) == 1
    error_output = capsys.readouterr().err
    assert error_output == (
        "canopen-control: a fault of this program, ZeroDivisionError: by accident; "
        "please report it with what CANOPEN_CONTROL_DEBUG=1 shows\n"
    )
    monkeypatch.setenv("CANOPEN_CONTROL_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        main(["check", "robby"])


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (OSError(errno.EMFILE, "Too many open files"), "too few open files; allow more: ulimit -n 1024\n"),
        (
            PermissionError(errno.EACCES, "Permission denied", "/secret/robot"),
            "/secret/robot: permission denied; give this user access to it\n",
        ),
    ],
)
def test_what_the_system_refuses_is_one_sentence(monkeypatch, capsys, error, text):
    def run(_args):
        raise error

    monkeypatch.setattr("canopen_control.cli.check.run", run)
    assert main(["check", "robby"]) == 2
    assert capsys.readouterr().err.endswith(text)


def program(*arguments, **how):
    command = [sys.executable, "-m", "canopen_control", *arguments]
    buffered = {key: value for key, value in os.environ.items() if key != "PYTHONUNBUFFERED"}
    return subprocess.Popen(command, env=buffered, stderr=subprocess.PIPE, text=True, **how)


@pytest.mark.process
@pytest.mark.parametrize("arguments", [["eds", "show", "TMCM-1270.eds"], ["bus", "list"], ["--help"]])
def test_a_reader_that_goes_is_not_a_failure_however_little_was_to_be_reported(private_folders, arguments):
    """Without PYTHONUNBUFFERED a short text is written at the end of Python, where it would be a traceback."""
    reader, writer = os.pipe()
    os.close(reader)
    with program(*arguments, stdout=writer) as process:
        os.close(writer)
        _, text = process.communicate(timeout=60)
    assert (process.returncode, text) == (0, "")


@pytest.mark.process
@pytest.mark.parametrize("arguments", [["eds", "show", "TMCM-1270.eds"], ["bus", "list"]])
def test_an_output_that_is_full_is_one_sentence(private_folders, arguments):
    with Path("/dev/full").open("w") as full, program(*arguments, stdout=full) as process:
        _, text = process.communicate(timeout=60)
    assert text == "canopen-control: standard output cannot be written: No space left on device\n"
    assert process.returncode == 1


def with_closed(streams, *command):
    """Run a command of Python with closed streams, written as in a shell."""
    shell = ["sh", "-c", f'exec "$@" {streams}', "sh", sys.executable, *command]
    return subprocess.run(shell, capture_output=True, text=True, timeout=60)


@pytest.mark.process
@pytest.mark.parametrize(
    ("streams", "verb", "code", "error"),
    [
        ("<&-", ["preflight", "robby", "--can", "memory:closed"], 2, "standard input is not a terminal"),
        ("2>&-", ["eds", "check", "TMCM-1270.eds"], 0, ""),  # it shows a progress
        ("<&- >&- 2>&-", ["eds", "check", "TMCM-1270.eds"], 0, ""),
    ],
)
def test_a_closed_standard_stream_is_an_empty_one(private_folders, streams, verb, code, error):
    done = with_closed(streams, "-m", "canopen_control", *verb)
    assert done.returncode == code, done
    assert error in done.stderr
    assert "fault of this program" not in done.stdout + done.stderr


@pytest.mark.process
def test_no_other_file_gets_the_number_of_a_closed_stream():
    code = """if True:
        import os, sys
        from canopen_control.cli import main
        main._open_closed_streams()
        assert [stream.fileno() for stream in (sys.stdin, sys.stdout, sys.stderr)] == [0, 1, 2]
        fds = range(3)
        assert {os.readlink(f"/proc/self/fd/{fd}") for fd in fds} == {os.devnull}
        assert all(map(os.get_inheritable, fds))
    """
    assert with_closed("<&- >&- 2>&-", "-c", code).returncode == 0


@pytest.mark.process
def test_a_character_that_the_locale_lacks_is_replaced():
    code = """if True:
        import sys
        from canopen_control.cli import main
        main._dispatch = lambda arguments: print("\\u2581 \\u00b0") or 0
        sys.exit(main.main())
    """
    environment = {**os.environ, "PYTHONIOENCODING": "latin-1"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, env=environment, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"? \xb0\n", b"")


@pytest.mark.process
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_what_a_lost_terminal_did_not_take_does_not_change_the_exit_code(private_folders, monkeypatch, unbuffered):
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    program = """if True:
        import sys, time
        from canopen_control.cli import main

        def run(arguments):
            sys.stdin.read(1)
            sys.stdout.write("a line without its end")
            return 0

        main._dispatch = run
        sys.exit(main.main([]))
    """
    ours, terminal = os.openpty()
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=terminal, stderr=terminal) as process:
        os.close(terminal)
        os.close(ours)
        process.communicate(b"x", timeout=60)
    assert process.returncode == 0


@pytest.mark.process
def test_help_imports_next_to_nothing():
    code = "import sys; sys.path.insert(0, sys.argv[1]); before = {*sys.modules}\n"
    code += "import atexit; atexit.register(lambda: print(*sorted({*sys.modules} - before), file=sys.stderr))\n"
    code += "from canopen_control.cli.main import main; main(['--help'])"
    command = [sys.executable, "-I", "-S", "-c", code, str(Path(__file__).parents[2])]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert not {"argparse", "typing", "re", "importlib.util"} & {*done.stderr.split()}
    assert done.stdout.startswith("usage: canopen-control VERB")
