"""The command `completion`: shtab generates the script of each shell from the parser.

The script is static, so a completion does not start Python; with argcomplete every completion would run linkplan.
"""

import argparse

from linkplan.api.names import DESIGNS, FILE_KINDS, FOLDER_FORMATS, FORMATS, LINEAR, MODELS, PROBLEMS, TRACKERS, problem_keys
from linkplan.cli.command_line import SHELLS, build_parser
from linkplan.cli.exit_codes import DONE
from linkplan.cli.printing import show
from linkplan.models.errors import ProblemError, choose

# The words and file name patterns that an argument accepts, by the argument's name in the help.
_TAKES: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "MODEL": ((*MODELS, *PROBLEMS), ("*.xml", "*.mjcf", "*.toml")),
    "MODEL-or-PROBLEM": ((*MODELS, *PROBLEMS), ("*.xml", "*.mjcf", "*.toml")),
    "PROBLEM": (PROBLEMS, ("*.toml",)),
    "PROBLEM-or-PLAN": (PROBLEMS, ("*.toml",)),
    "PLAN": (PROBLEMS, ("*.toml",)),
    "PLAN-or-MODEL": ((*PROBLEMS, *MODELS), ("*.toml", "*.xml", "*.mjcf")),
    "BATCH": ((), ("*.toml",)),
    "DIR": ((), ()),
    "FILE": ((), ("*",)),
    "NAME": (TRACKERS, ()),
    "NAMES": ((*TRACKERS, "all"), ()),
    "LAW": (LINEAR, ()),
    "DESIGN": (DESIGNS, ()),
    "KIND": (FILE_KINDS, ()),
    "FORMAT": ((*FORMATS, *FOLDER_FORMATS), ()),
    "SHELL": (SHELLS, ()),
}
_WORDS_ONLY = ("NAME", "NAMES", "LAW", "DESIGN", "KIND", "FORMAT", "SHELL")
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
    shell = choose("shell", arguments.shell, SHELLS, ProblemError)
    text = completion_script(shell)
    show(arguments, {"shell": shell, "script": text}, text.rstrip("\n"))
    return DONE


def completion_script(shell: str) -> str:
    """Return a shell's completion script."""
    import shtab

    parser = build_parser()
    for command in (parser, *parser.commands().values()):
        for action in command._actions:
            takes = _completed(str(action.metavar))
            if takes is not None:
                action.complete = takes
    text = shtab.complete(parser, shell)
    return text + _BASH_WITHOUT_BLANK if shell == "bash" else text


def _completed(metavar: str) -> dict | None:
    """Return the completion of an argument in each shell, in the form of shtab; None for an unknown argument."""
    if metavar == "KEY=VALUE":
        return _function("settings", _SETTINGS, (), folders=False)
    if metavar not in _TAKES:
        return None
    return _function(metavar.lower().replace("-", "_"), *_TAKES[metavar], folders=metavar not in _WORDS_ONLY)


def _function(name: str, words: tuple[str, ...], patterns: tuple[str, ...], *, folders: bool) -> dict:
    """Return a completion by words, files that match patterns, and folders, as a function in the preamble of each shell."""
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
