"""`python -m canopen_control` is the command line."""

from canopen_control.cli.main import main

if __name__ == "__main__":
    raise SystemExit(main())
