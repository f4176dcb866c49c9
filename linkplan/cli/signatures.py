"""The commands as their public functions describe them, read from the source without an import of solver or simulator."""

import ast
import functools
import re
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import linkplan
from linkplan.api import names

# Parameters of Python alone: a callback, tables that --set sets, the environment of the process.
_OF_PYTHON = ("progress", "tell", "tracking", "imperfections", "mujoco_gl")
NEEDED = object()


@dataclass(frozen=True)
class Parameter:
    """A parameter of a public function: its annotation as written, its default or `NEEDED`, and its sentence in `Args`."""

    name: str
    annotation: str
    default: object
    text: str

    @property
    def is_optional(self) -> bool:
        """True if it has a default."""
        return self.default is not NEEDED


@dataclass(frozen=True)
class Command:
    """A command: what `@command` says of it, and the parameters of its function."""

    name: str
    text: str
    saved: bool
    note: str
    showing: tuple[str, ...]
    without: tuple[str, ...]
    parameters: tuple[Parameter, ...]

    @property
    def positional(self) -> Parameter | None:
        """The parameter that is the command's argument: the first one, unless it is the place of the result."""
        first = self.parameters[0] if self.parameters else None
        return None if first is None or first.name in ("folder", "path") else first


@functools.cache
def commands() -> dict[str, Command]:
    """Return all commands by name, in the order of the public names."""
    modules = [module for module in linkplan._MODULES if module.startswith("linkplan.api.")]
    found = (
        command
        for module in (*modules, "linkplan.cli.commands", "linkplan.cli.completion_command")
        for command in _commands_of(_source(module))
    )
    return {command.name: command for command in found}


def selection_parameters() -> dict[str, Parameter]:
    """Return the parameters that select a part of a model, options of most commands, by name."""
    return {parameter.name: parameter for parameter in commands()["new"].parameters if parameter.name in names.SELECTION}


def _source(module: str) -> ast.Module:
    spec = find_spec(module)
    assert spec is not None
    assert spec.origin is not None
    return ast.parse(Path(spec.origin).read_text(encoding="utf-8"))


def _commands_of(module: ast.Module) -> list[Command]:
    found = []
    for function in (node for node in module.body if isinstance(node, ast.FunctionDef)):
        for call in function.decorator_list:
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "command":
                said = {word.arg: _value(word.value) for word in call.keywords}
                found.append(
                    Command(
                        name=function.name.removesuffix("_command"),
                        text=ast.literal_eval(call.args[0]),
                        saved=said.get("saved", False),
                        note=said.get("note", ""),
                        showing=tuple(said.get("showing", ())),
                        without=tuple(said.get("without", ())),
                        parameters=tuple(_parameters(function)),
                    )
                )
    return found


def _parameters(function: ast.FunctionDef) -> list[Parameter]:
    texts, listed = _sentences(ast.get_docstring(function) or ""), function.args
    defaults = [None] * (len(listed.args) - len(listed.defaults)) + listed.defaults + listed.kw_defaults
    return [
        Parameter(
            name=argument.arg,
            annotation="" if argument.annotation is None else ast.unparse(argument.annotation).removesuffix(" | None"),
            default=NEEDED if default is None else _value(default),
            text=texts.get(argument.arg, ""),
        )
        for argument, default in zip(listed.args + listed.kwonlyargs, defaults, strict=True)
        if argument.arg not in _OF_PYTHON
    ]


def _value(default: ast.expr) -> Any:
    """Return the value of a default: a literal, or a name of `linkplan.api.names`."""
    return getattr(names, default.id) if isinstance(default, ast.Name) else ast.literal_eval(default)


def _sentences(docstring: str) -> dict[str, str]:
    """Return the first sentence on each parameter in a docstring's `Args`."""
    section = re.search(r"^Args:\n((?:[ ]+.*\n?)+)", docstring, re.MULTILINE)
    if section is None:
        return {}
    entries = re.findall(r"^    (\w+): ((?:.*\n?)(?:^     +.*\n?)*)", section[1], re.MULTILINE)
    firsts = {name: re.split(r"\.(?= [A-Z`]|$)", " ".join(text.split()))[0] for name, text in entries}
    return {name: first.replace("`", "") for name, first in firsts.items()}
