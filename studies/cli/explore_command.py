"""The command `explore`."""

import argparse
import threading
from dataclasses import dataclass, field
from pathlib import Path

from linkplan.models.errors import ProblemError
from linkplan.planner.files.tables import BUILT_IN as PROBLEMS
from linkplan.planner.files.tables import read_tables
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import whole
from linkplan.studies.cli.common import new_file, refuse_no_model, selection_asked, set_all
from linkplan.studies.cli.exit_codes import DONE, saved_fault_report
from linkplan.studies.cli.printing import flush_streams, progress, refuse, show


def run_explore(arguments: argparse.Namespace) -> int:
    """Serve the page of a problem's sliders until Ctrl-C."""
    from linkplan.studies.explore.server import Server
    from linkplan.studies.explore.session import Session

    target, say = new_file(arguments), progress(arguments)
    whole(arguments.port, "--port", 0, 65535)
    session = Session(first=_problem(arguments, say))
    save = SavedProblem(place=Path("problem.toml") if target is None else target).save
    try:
        server = Server(session, save, arguments.port, tell=_tell)
    except OSError as error:
        raise ProblemError(f"port {arguments.port} of 127.0.0.1 cannot be used: {error.strerror or error}") from error
    with server:
        said = {"problem": session.first.name, "address": server.address}
        show(arguments, said, f"open {server.address} in a browser; Ctrl-C ends")
        flush_streams()  # the address is read while the command runs
        server.serve_forever()
    return DONE


def _problem(arguments: argparse.Namespace, say) -> Problem:
    """Return the problem of a file or a built-in name, or the first motion of a model."""
    if arguments.model in PROBLEMS or arguments.model.endswith(".toml"):
        name, tables, folder = read_tables(arguments.model)
    else:
        from linkplan.studies.new.first_motion import first_motion
        from linkplan.studies.new.problem_text import file_tables

        refuse_no_model(arguments.model)
        say(f"looking for a first motion of {arguments.model}")
        found = first_motion({"model": arguments.model} | selection_asked(arguments), say)
        if not found.planned:
            raise ProblemError(f"no first motion of '{arguments.model}' was found: {found.why}")
        name, tables, folder = f"{found.mechanism.name}-first", file_tables(found, arguments.model, None), None
    set_all(tables, arguments.set)
    return Problem.from_tables(name, tables, folder)


@dataclass(eq=False, kw_only=True)
class SavedProblem:
    """The problem file of a page. Mutable: it keeps what it wrote, which alone it replaces."""

    place: Path
    written: bytes | None = None
    lock: threading.Lock = field(default_factory=threading.Lock)

    def save(self, problem: Problem) -> str:
        """Write the file, and return its path.

        Raises:
            PlanFileError: if the file is there and is not as this page wrote it.
        """
        from linkplan.planner.files.single_file import write_again, write_new

        content = problem.to_toml().encode("utf-8")
        with self.lock:
            if self.written is None:
                write_new(self.place, content)
            else:
                write_again(self.place, content, self.written)
            self.written = content
        return str(self.place)


def _tell(error: BaseException) -> None:
    """Print one line on an error that a request has met."""
    refuse("explore", saved_fault_report(error))
