"""Entry point of the command line; the module of a verb is imported only when the verb is used.

Exit codes: 0 success, 1 failure, 2 usage or configuration (`errors.CanopenError.of_usage`), even if a running robot
reports it; 130 interrupted by SIGINT, SIGTERM or SIGHUP, unless the verb handles these signals itself. A user sees one
sentence, never a traceback, unless CANOPEN_CONTROL_DEBUG is set.
"""

from __future__ import annotations

import errno
import importlib
import itertools
import os
import stat
import sys

from canopen_control.cli.verbs import VERBS, overview
from canopen_control.errors import CanopenError, ConfigError, NoRobotError
from canopen_control.host.signals import INTERRUPTED, ProcessSignals

TYPE_CHECKING = False  # the module typing takes longer to import than all that --help needs
if TYPE_CHECKING:
    from collections.abc import Sequence


#: verbs that only send requests to a running robot, and run no code of plugins
_REQUESTING = frozenset(
    {"status", "command", "twist", "stop", "shutdown", "controller", "axis", "sdo", "nmt", "fault", "quirk", "bus"}
)
_OUTPUT_LOST = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


_signals = ProcessSignals()


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code, or complete words if a shell requests completion.

    Without `argv` this process is the program itself, and SIGINT, SIGTERM and SIGHUP end it at any moment.
    """
    if "_ARGCOMPLETE" in os.environ:
        from canopen_control.cli.support.completion_words import answer_shell

        answer_shell()
    if argv is not None:
        return _run_and_flush(list(argv))
    try:
        try:
            _signals.begin()
            _open_closed_streams()
            _replace_unknown_characters()
            return _run_and_flush(sys.argv[1:])
        finally:
            _signals.finish()
    except KeyboardInterrupt:  # outside the verb
        _signals.finish()
        return INTERRUPTED


def _open_closed_streams() -> None:
    """Open the null device for each standard stream that the caller has closed (`<&-`, `>&-`, `2>&-`).

    Otherwise Python has no such stream, and a socket could get its number, which a child process uses as the stream.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            fd = os.open(os.devnull, os.O_RDWR)  # the smallest free number, which is the number of the stream
            os.set_inheritable(fd, True)
            stream = open(fd, mode)  # noqa: SIM115 - as long as the process
            setattr(sys, name, stream)
            setattr(sys, f"__{name}__", stream)


def _replace_unknown_characters() -> None:
    """Print `?` for a character that the encoding of standard output lacks, such as in the curves of `scope`."""
    if sys.stdout.encoding.lower() not in ("utf-8", "utf8") and hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(errors="replace")


def _run_and_flush(arguments: list[str]) -> int:
    code = 0
    try:
        code = _run(arguments)
    finally:  # argparse leaves by SystemExit
        lost = _flush()
    return code or lost


def _run(arguments: list[str]) -> int:
    try:
        return _dispatch(arguments)
    except KeyboardInterrupt:
        return INTERRUPTED
    except Exception as error:  # noqa: BLE001 - an internal error also becomes one sentence, with advice
        if _signals.received and _replaces_interrupt(error):
            return INTERRUPTED
        code = _report(error, _named_robot(arguments))
        return INTERRUPTED if _signals.received else code


def _named_robot(arguments: list[str]) -> str | None:
    """Return the running robot that the command names with --name, None without that option."""
    for word, value in itertools.pairwise([*arguments, ""]):
        if word == "--name":
            return value
        if word.startswith("--name="):
            return word.partition("=")[2]
    return None


def _replaces_interrupt(error: Exception) -> bool:
    """Whether an exception raised after a signal stands for KeyboardInterrupt, such as a RuntimeError of pybind11."""
    return not isinstance(error, CanopenError) or isinstance(error.__cause__, RuntimeError | SystemError)


def _report(error: Exception, robot: str | None = None) -> int:
    """Print the error that ended a verb as one sentence; return the exit code.

    A robot does not know whether others run: commands in its advice get the name with which it was selected.
    """
    if isinstance(error, CanopenError):
        text = str(error)
        lacks_name = "canopen-control " in text and "--name" not in text and "--as " not in text
        shown = CanopenError(f"{text} (with --name {robot})") if lacks_name and robot is not None else error
        return _print_error(shown, 2 if error.of_usage else 1)
    if isinstance(error, BrokenPipeError):
        _leave_output()
        return 0
    if isinstance(error, OSError) and error.filename is None and error.errno in _OUTPUT_LOST:
        return _report_lost_output(error)
    if isinstance(error, OSError) and error.errno == errno.EMFILE:
        return _print_error(CanopenError("this shell allows too few open files; allow more: ulimit -n 1024"), 2)
    if isinstance(error, PermissionError) and error.filename is not None:
        return _print_error(CanopenError(f"{error.filename}: permission denied; give this user access to it"), 2)
    return _report_internal_error(error)


def _flush() -> int:
    """Flush standard output, so that a failure is reported without a traceback; return the exit code."""
    try:
        if sys.stdout is not None:  # standard output was closed from the start
            sys.stdout.flush()
    except BrokenPipeError:
        _leave_output()
    except OSError as error:
        return _report_lost_output(error)
    return 0


def _leave_output() -> None:
    """Discard the remaining output because its reader has ended (`| head`) or the disk is full."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _dispatch(arguments: list[str]) -> int:
    if arguments in (["-h"], ["--help"]):
        print(overview(), end="")
        raise SystemExit(0)  # like argparse
    verb = arguments[0] if arguments else ""
    if verb == "status":
        from canopen_control.cli.status import run_plain

        if run_plain(arguments[1:]):
            return 0
    from canopen_control.cli.support.parsers import parser_of, top_parser

    if verb not in VERBS:
        if verb and not verb.startswith("-"):
            raise ConfigError(_no_verb(verb))
        parser = top_parser()
        parser.parse_args(arguments)  # --help, --version, or the error that names the verbs
        parser.print_help()
        return 2
    if verb in _REQUESTING:
        from canopen_control.rpc.quick_verbs import import_msgspec  # --help needs none of it

        import_msgspec()
    args = parser_of(verb).parse_args(arguments[1:])
    try:
        return int(importlib.import_module(f"canopen_control.cli.{verb}").run(args))
    except NoRobotError as error:
        if "can" not in args or args.can:
            raise
        raise ConfigError(f"{error}, or give the channel of a bus without a robot, as in --can can0") from None


def _no_verb(word: str) -> str:
    import difflib

    suggestions = _with_action(word) or difflib.get_close_matches(word, VERBS, 2)
    hint = f"did you mean {' or '.join(suggestions)}?" if suggestions else "canopen-control help --all lists every verb"
    return f"no verb {word!r}; {hint}"


def _with_action(word: str) -> list[str]:
    """Return the commands `canopen-control VERB ACTION` that have an action of this name."""
    from canopen_control.cli.support.parsers import parser_of

    return [
        f"canopen-control {verb} {word}"
        for verb in VERBS
        for action in parser_of(verb)._actions  # noqa: SLF001 - no public way
        if not action.option_strings and word in (action.choices or ())
    ]


def _report_lost_output(error: OSError) -> int:
    if error.errno == errno.EIO and stat.S_ISCHR(os.fstat(sys.stdout.fileno()).st_mode):
        _leave_output()  # the terminal was closed, and standard error with it
        return 0
    print(f"canopen-control: standard output cannot be written: {error.strerror}", file=sys.stderr)
    _leave_output()
    return 1


def _report_internal_error(error: Exception) -> int:
    if os.environ.get("CANOPEN_CONTROL_DEBUG"):
        raise error
    if isinstance(error, MemoryError):
        return _print_error(CanopenError("out of memory; is a file far larger than it should be?"), 1)
    kind, text = type(error).__name__, f": {error}" if str(error) else ""
    text_of_fault = f"a fault of this program, {kind}{text}; please report it with what CANOPEN_CONTROL_DEBUG=1 shows"
    print(f"canopen-control: {text_of_fault}", file=sys.stderr)
    return 1


def _print_error(error: CanopenError, code: int) -> int:
    if os.environ.get("CANOPEN_CONTROL_DEBUG"):
        raise error
    print(f"canopen-control: {error}", file=sys.stderr)
    return code
