"""`view`, `explore` and `demo`: a plan in MuJoCo's viewer, a page of sliders, and all studies of the knee."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from linkplan.api.command import command
from linkplan.api.inputs import PlanLike, Source, Subject, plan_of, source_of
from linkplan.api.names import KEYS_TEXT, TrackerName
from linkplan.api.reporting import Listener, Progress, listener
from linkplan.models.errors import ProblemError, choose
from linkplan.models.mechanism import Mechanism
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import number, whole
from linkplan.studies.output.paths import file_to_write, folder_to_write

if TYPE_CHECKING:
    from linkplan.studies.explore.server import Server

_ALTERNATIVES = "render writes the same motion as a film or a picture, report as a page"


@command("play a tracked plan in MuJoCo's interactive viewer, where keys change its gains", note=KEYS_TEXT)
def view(
    plan: PlanLike,
    *,
    tracker: TrackerName = "pd+ff",
    slow: float = 4.0,
    seconds: float | None = None,
    progress: Progress | None = None,
) -> dict:
    """Play a tracked plan in MuJoCo's interactive viewer, and return the tracker and gains at the end.

    Args:
        plan: with a motion; or its problem, or the name or path of either.
        tracker: a built-in name.
        slow: playback is this many times slower than real time.
        seconds: the window closes after this time; by default when you close it.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: if no window can be opened, the plan has no motion, or an argument is invalid.

    Example::

        linkplan.view("knee-reach", slow=10.0)
    """
    from linkplan.controllers.controls import Controls
    from linkplan.controllers.playback import has_screen, play
    from linkplan.controllers.trackers.names import TRACKERS
    from linkplan.studies.render.gl import find_gl

    choose("tracker", tracker, TRACKERS, ProblemError)
    number(slow, "slow", positive=True)
    if seconds is not None:
        number(seconds, "seconds", positive=True)
    if not has_screen():
        raise ProblemError(f"view needs a screen: neither DISPLAY nor WAYLAND_DISPLAY is set; {_ALTERNATIVES}")
    gl = find_gl("glfw")
    if gl.name is None:
        raise ProblemError(f"view needs a screen, and none can be opened ({gl.why_not}); {_ALTERNATIVES}")
    say = listener(progress)
    answer = plan_of(plan, say, "play")
    from linkplan.studies.render.live import aim, run_maker
    from linkplan.studies.render.scenes import coloured_model

    say.keep(f"{answer.problem.name} tracked by {tracker}, {slow:g} times slower; close the window to end")
    say.keep(f"keys: {KEYS_TEXT}")
    make = run_maker(answer)
    begin = Controls(tracker=tracker, slowness=slow)
    mechanism = answer.problem.mechanism
    last = play(
        replace(mechanism, model=coloured_model(mechanism)), begin, make, seconds=seconds, camera=aim(answer, tracker)
    )
    gains = {"kp_factor": last.kp_factor, "kd_factor": last.kd_factor}
    said = {"plan": answer.problem.name, "tracker": last.tracker, **gains, "stable": make(last).stable}
    return said | {"passed": answer.passed}


@command("open a web page with sliders; the plan and the tracking result update as you move them")
def explore(
    subject: Subject,
    path: str | Path | None = None,
    *,
    port: int = 0,
    tell: Callable[[BaseException], None] = lambda _: None,
    progress: Progress | None = None,
) -> Exploration:
    """Return a page with sliders for a problem, which update its plan and tracking result. `serve` answers its requests.

    Args:
        subject: a `Problem`, or its name or path; or a mechanism or its name, for which a first motion is searched.
        path: the problem file that the page's button writes, by default problem.toml; it must not exist yet.
        port: port of 127.0.0.1; 0 for a free one.
        tell: called with unexpected errors of requests.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: if there is no problem to explore, a file exists at the path, or the port is in use.

    Example::

        page = linkplan.explore("knee-reach")
        print(page.address)  # page.serve() answers a browser
    """
    from linkplan.studies.explore.server import Server
    from linkplan.studies.explore.session import Session

    target, say = Path("problem.toml") if path is None else file_to_write(path), listener(progress)
    whole(port, "port", 0, 65535)
    session = Session(first=_problem(subject, say))
    try:
        server = Server(session, SavedProblem(place=target).save, port, tell=tell)
    except OSError as error:
        raise ProblemError(f"port {port} of 127.0.0.1 cannot be used: {error.strerror or error}") from error
    return Exploration(name=session.first.name, server=server)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Exploration:
    """A page of sliders: the problem's name and the server, whose `address` a browser opens."""

    name: str
    server: Server

    @property
    def address(self) -> str:
        """The page's address."""
        return self.server.address

    def serve(self) -> None:
        """Answer the page's requests until an interrupt."""
        with self.server:
            self.server.serve_forever()


def _problem(subject: Subject, say: Listener) -> Problem:
    """Return the problem of a file or a built-in name, or the first motion of a model."""
    if isinstance(subject, Problem):
        return subject
    from linkplan.studies.check.new.first_motion import first_motion
    from linkplan.studies.check.new.problem_text import file_tables

    if isinstance(subject, Mechanism):
        model, section, further = str(subject.source["model"]), dict(subject.source), {}
    else:
        source: Source = source_of(subject)
        if source.is_problem:
            return source.problem()
        model, (_, further, _) = source.name, source.tables()
        section = further.pop("mechanism")
    say(f"looking for a first motion of {model}")
    found = first_motion(section, say)
    if not found.planned:
        raise ProblemError(f"no first motion of '{model}' was found: {found.why}")
    tables = file_tables(found, model, None)
    for name, table in further.items():
        tables[name] = tables.get(name, {}) | table
    return Problem.from_tables(f"{found.mechanism.name}-first", tables, None)


@dataclass(eq=False, kw_only=True)
class SavedProblem:
    """The problem file of a page. Mutable: it remembers what it wrote, because it replaces nothing else."""

    place: Path
    written: bytes | None = None
    lock: threading.Lock = field(default_factory=threading.Lock)

    def save(self, problem: Problem) -> str:
        """Write the file, and return its path.

        Raises:
            PlanFileError: if the file exists and differs from what this page wrote.
        """
        from linkplan.planner.files.single_file import write_again

        content = problem.to_toml().encode("utf-8")
        with self.lock:
            write_again(self.place, content, self.written)
            self.written = content
        return str(self.place)


@command("check, plan and track the Optimus knee, with margins; write all into one folder")
def demo(folder: str | Path = "linkplan-demo", *, progress: Progress | None = None) -> tuple[dict, list]:
    """Run all studies of the Optimus knee into one folder; return their records and the document.

    Args:
        folder: the folder for the results; an older demo in it is replaced.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: if the folder cannot be written.

    Example::

        said, blocks = linkplan.demo("linkplan-demo")
    """
    from linkplan.studies.demo.demo import demo as made

    return made(folder_to_write(folder, "demo.json"), listener(progress))
