"""`completion`: completion of verbs, options and names for a shell.

bash: add to ~/.bashrc        eval "$(canopen-control completion bash)"
zsh: add to ~/.zshrc          eval "$(canopen-control completion zsh)"
fish: once                    canopen-control completion fish > ~/.config/fish/completions/canopen-control.fish

The script asks `canopen-control completion words WORD...`, which prints what the last word may become: of verbs and
options always, of controllers, nodes and buses where a robot runs and answers at once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cli.completion_words import complete

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

__all__ = ["EXAMPLE", "add_arguments", "run"]

EXAMPLE = 'canopen-control completion bash  # as in eval "$(canopen-control completion bash)"'

_BASH = r"""_canopen_control() {
    local line="${COMP_LINE:0:COMP_POINT}" word current prefix
    local -a words
    read -ra words <<< "$line"
    [[ -z "$line" || "$line" == *[[:space:]] ]] && words+=("")
    current="${words[${#words[@]}-1]}"
    COMPREPLY=()
    while IFS= read -r word; do
        case "$word" in
            @files) compopt -o filenames 2> /dev/null
                    while IFS= read -r word; do COMPREPLY+=("$word"); done < <(compgen -f -- "$current") ;;
            @dirs) compopt -o filenames 2> /dev/null
                   while IFS= read -r word; do COMPREPLY+=("$word"); done < <(compgen -d -- "$current") ;;
            *) COMPREPLY+=("${word%%$'\t'*}") ;;
        esac
    done < <("${words[0]/#\~/$HOME}" completion words "${words[@]:1}" 2> /dev/null)
    # readline takes a colon for the end of a word, so what stands before it must not come again
    if [[ "$current" == *:* && "$COMP_WORDBREAKS" == *:* ]]; then
        prefix="${current%"${current##*:}"}"
        COMPREPLY=("${COMPREPLY[@]#"$prefix"}")
    fi
}
complete -F _canopen_control canopen-control
"""

_ZSH = r"""#compdef canopen-control
_canopen_control() {
    local line
    local -a found
    for line in "${(@f)$("${words[1]}" completion words "${(@)words[2,CURRENT]}" 2> /dev/null)}"; do
        case "$line" in
            @files) _files ;;
            @dirs) _files -/ ;;
            ?*) found+=("${line%%$'\t'*}") ;;
        esac
    done
    (( $#found )) && compadd -a found
}
if [[ "${funcstack[1]}" == "_canopen_control" ]]; then
    _canopen_control "$@"
else
    compdef _canopen_control canopen-control
fi
"""

_FISH = r"""function __canopen_control_words
    set -l words (commandline -opc) (commandline -ct)
    for line in ($words[1] completion words $words[2..-1] 2> /dev/null)
        switch $line
            case @files
                __fish_complete_path (commandline -ct)
            case @dirs
                __fish_complete_directories (commandline -ct)
            case '*'
                echo $line
        end
    end
end
complete -c canopen-control -f -a '(__canopen_control_words)'
"""

SCRIPTS = {"bash": _BASH, "zsh": _ZSH, "fish": _FISH}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    shells = parser.add_subparsers(dest="shell", metavar="bash|zsh|fish", required=True)
    for shell in SCRIPTS:
        shells.add_parser(shell, help=f"print the script for {shell}")
    # every word is left alone, options too: they are those of the line that is being typed
    words = shells.add_parser("words", add_help=False, prefix_chars="\0", help="what the last WORD may become")
    words.add_argument("words", nargs="*", metavar="WORD")


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    action: Callable[[argparse.Namespace], int] = _words if args.shell == "words" else _script
    return action(args)


def _script(args: argparse.Namespace) -> int:
    print(SCRIPTS[args.shell], end="")
    return 0


def _words(args: argparse.Namespace) -> int:
    for word, text in complete(args.words or [""]):
        print(f"{word}\t{text}" if text else word)
    return 0
