"""Public functions that are commands."""

from collections.abc import Callable, Sequence
from typing import TypeVar

Function = TypeVar("Function", bound=Callable)


def command(
    text: str, *, saved: bool = False, note: str = "", showing: Sequence[str] = (), without: Sequence[str] = ()
) -> Callable[[Function], Function]:
    """Make a public function a command of the same name.

    The command line reads this call, the function's parameters and the first sentence on each in `Args` from the source, so
    that help needs no import of solvers (`linkplan/cli/signatures.py`).

    Args:
        text: what the command does, as in the list of commands.
        saved: whether -o saves the result in a folder, whose record has the command's name.
        note: what the help says beside the options.
        showing: options on what is printed and written further: "all", "report", "parquet", "jumps".
        without: options on the reading of the first argument that make no difference here.
    """
    del text, saved, note, showing, without
    return lambda function: function
