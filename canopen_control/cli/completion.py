"""Print a script that completes verbs, options and names in a shell.

    bash: add to ~/.bashrc        eval "$(canopen-control completion bash)"
    zsh: add to ~/.zshrc          eval "$(canopen-control completion zsh)"
    fish: once                    canopen-control completion fish > ~/.config/fish/completions/canopen-control.fish

The script is argcomplete's. It always offers verbs and options, and controllers, nodes and buses of a running robot
that answers at once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import argparse


EXAMPLE = 'canopen-control completion bash  # as in eval "$(canopen-control completion bash)"'
SHELLS = ("bash", "zsh", "fish")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("shell", choices=SHELLS, help="shell of the script")


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    from argcomplete.shell_integration import shellcode

    # Without readline's own completion, which offers files if there are no words.
    print(shellcode(["canopen-control"], use_defaults=False, shell=args.shell), end="")
    return 0
