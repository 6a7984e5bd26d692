"""Entry point of `python -m canopen_control`."""

from canopen_control.cli.main import main

if __name__ == "__main__":
    raise SystemExit(main())
