"""The command `completion`: shtab generates the script of each shell from the parser.

The script is static, so a completion does not start Python; with argcomplete every completion would run linkplan.
"""

import argparse

from linkplan.api.command import command
from linkplan.api.names import SHELLS, Shell, problem_keys
from linkplan.cli.command_line import build_parser
from linkplan.cli.exit_codes import DONE
from linkplan.cli.option_kinds import KINDS, Kind
from linkplan.cli.printing import show
from linkplan.models.errors import ProblemError, choose

# A value follows the "=" of a setting without a space.
_SETTINGS = tuple(f"{key}=" for key in problem_keys())
_BASH_WITHOUT_BLANK = """
_linkplan_without_blank() {
  _shtab_linkplan "$@"
  if [[ ${#COMPREPLY[@]} == 1 && ${COMPREPLY[0]} == *= ]]; then compopt -o nospace; fi
}
complete -o bashdefault -F _linkplan_without_blank linkplan
"""


def run_completion(arguments: argparse.Namespace) -> int:
    """Print a shell's completion script."""
    text = completion_command(arguments.shell)
    show(arguments, {"shell": arguments.shell, "script": text}, text.rstrip("\n"))
    return DONE


@command("print a shell's completion script")
def completion_command(shell: Shell) -> str:
    """Return a shell's completion script.

    Args:
        shell: bash, zsh or fish; e.g. linkplan completion bash > ~/.local/share/bash-completion/completions/linkplan

    Raises:
        ProblemError: for another shell.
    """
    import shtab

    choose("shell", shell, SHELLS, ProblemError)
    by_metavar = {kind.metavar: kind for kind in KINDS.values() if kind.words or kind.patterns or kind.folders}
    parser = build_parser()
    for one in (parser, *parser.commands().values()):
        for action in one._actions:
            metavar = str(action.metavar)
            if metavar == "KEY=VALUE":
                action.complete = _function("settings", Kind(metavar=metavar, words=_SETTINGS))
            elif metavar in by_metavar:
                action.complete = _function(metavar.lower().replace("-", "_"), by_metavar[metavar])
    text = shtab.complete(parser, shell)
    return text + _BASH_WITHOUT_BLANK if shell == "bash" else text


def _function(name: str, kind: Kind) -> dict:
    """Return a completion by words, files that match patterns, and folders, as a function in the preamble of each shell."""
    words, patterns, folders = kind.words, kind.patterns, kind.folders
    function, said = f"_linkplan_{name}", " ".join(words)
    bash = [f"{function}() {{", f'  compgen -W "{said}" -- "$1"' if words else ""]
    bash += [f"  compgen -f -X '!{pattern}' -- \"$1\"" for pattern in patterns if pattern != "*"]
    bash += ['  compgen -f -- "$1"' if "*" in patterns else '  compgen -d -S / -- "$1"' if folders else "", "}"]
    zsh = [f"{function}() {{"]
    if words:
        zsh.append(f"  compadd -S '' -- {said}" if name == "settings" else f"  compadd -- {said}")
    if "*" in patterns:
        zsh.append("  _files")
    elif folders:
        zsh.append(f"  _files -g '({'|'.join(patterns)})'" if patterns else "  _files -/")
    fish = [f"function {function}", f"  printf '%s\\n' {said}" if words else ""]
    if patterns:
        fish.append("  __fish_complete_path (commandline -ct)")
    elif folders:
        fish.append("  __fish_complete_directories (commandline -ct)")
    preamble = {"bash": bash, "zsh": [*zsh, "}"], "fish": [*fish, "end"]}
    found: dict = {"bash": function, "zsh": function, "fish": f"({function})"}
    return found | {"preamble": {shell: "\n".join(line for line in lines if line) for shell, lines in preamble.items()}}
