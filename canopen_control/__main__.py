"""Entry point of the program, as `canopen-control` and as `python -m canopen_control`."""

import signal


def main() -> int:
    """Run the command line; SIGINT during its imports ends the process without a traceback, with the exit code 130."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # a shell reports 128 + SIGINT
    from canopen_control.cli.main import main as run_command_line

    return run_command_line()


if __name__ == "__main__":
    raise SystemExit(main())
