"""What plans of robots of several motors cost, as whole processes, beside the same problems by hand: `make bench many`.

    python -m tests.bench.many [FOLDER] [--only WORD ...] [--kinds KIND ...] [--empty-cache] [--no-peer] [-o JSON]
    python -m tests.bench.many --draw docs/pictures/many-motors.png -o JSON

FOLDER holds problem files NAME-KIND.toml, and may hold best_known.json; by default the own robots are written and planned.
Processor time is user and system time of `linkplan plan` with all processes that it starts, compilers too.
The peer (`tests.bench.many_peer`) loads, builds and solves once; what it finds has no certificate.
"""

import argparse
import contextlib
import json
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from linkplan.studies.output.figure import BLUE, ORANGE, page
from linkplan.studies.output.text import table
from tests.bench.many_robots import KINDS, write_robots
from tests.bench.timing import own_cache, say

# The longest wall time [s] of a process: problem files ask for at most 60 s.
_PATIENCE_S = 300.0
_PASSED = ("optimal", "feasible")


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Compared:
    """A problem's plan and the peer's answer: processor times [s], statuses, objectives in the objective's unit.

    Objectives are None where there is no motion; `best_known` where none is known.
    """

    problem: str
    kind: str
    motors: int
    processor_s: float
    status: str
    message: str
    objective: float | None
    peer_processor_s: float | None = None
    peer_status: str = ""
    peer_objective: float | None = None
    best_known: float | None = None

    @property
    def over_best(self) -> float | None:
        """By how much the plan's objective is over the least of peer's and best known, as a share; None without one."""
        known = [value for value in (self.peer_objective, self.best_known) if value]
        return self.objective / min(known) - 1 if known and self.objective and self.status in _PASSED else None


def run_counted(command: Sequence[str]) -> tuple[float, dict]:
    """Run this Python on a command and return the processor time [s] of it and all its descendants, and its JSON.

    Without JSON the status is "refused", with the end of stderr, or "killed" after too long.
    """
    counted = [sys.executable, str(Path(__file__).with_name("counted.py")), str(_PATIENCE_S), sys.executable, *command]
    ran = json.loads(subprocess.run(counted, capture_output=True, text=True, check=True).stdout)
    if ran["code"] is None:
        said = {"status": "killed", "message": f"no answer in {_PATIENCE_S:g} s of wall time"}
    else:
        refused = {"status": "refused", "message": ran["stderr"].strip()[-200:]}
        said = json.loads(ran["stdout"]) if ran["stdout"] else refused
    return ran["processor_s"], said


def compared(problem: Path, *, peer: Compared | None = None, no_peer: bool = False) -> Compared:
    """Plan a problem file by `linkplan plan` and by the peer, unless the `peer`'s answer is known or not asked for."""
    known = problem.parent / "best_known.json"
    values = json.loads(known.read_text(encoding="utf-8"))["values"] if known.exists() else {}
    motion = tomllib.loads(problem.read_text(encoding="utf-8"))["motion"]
    spent, plan = run_counted(["-m", "linkplan", "plan", str(problem), "--json"])
    found = Compared(
        problem=problem.stem,
        kind=problem.stem.rsplit("-", 1)[-1],
        motors=len(motion.get("start_deg", {})) + len(motion.get("start_m", {})),
        processor_s=spent,
        status=plan["status"],
        message=plan["message"],
        objective=plan.get("objective"),
        best_known=values.get(problem.stem, {}).get("value"),
    )
    if no_peer:
        return found
    if peer is not None:
        seconds, status, objective = peer.peer_processor_s, peer.peer_status, peer.peer_objective
    else:
        seconds, answer = run_counted(["-m", "tests.bench.many_peer", str(problem)])
        status, objective = answer["status"], answer.get("objective")
    return replace(found, peer_processor_s=seconds, peer_status=status, peer_objective=objective)


def compare_all(
    problems: Iterable[Path],
    *,
    peers: Mapping[str, Compared],
    no_peer: bool = False,
    empty_cache: bool = False,
    into: Path | None = None,
) -> list[Compared]:
    """Compare problem files one after another; what is done is written `into` a JSON file after each."""
    found: list[Compared] = []
    for problem in problems:
        say(f"many: {problem.stem}")
        with own_cache() if empty_cache else contextlib.nullcontext():
            found.append(compared(problem, peer=peers.get(problem.stem), no_peer=no_peer))
        if into is not None:
            into.write_text(json.dumps([asdict(one) for one in found], indent=1) + "\n", encoding="utf-8")
    return found


def load_compared(path: Path | None) -> dict[str, Compared]:
    """Return the answers of a JSON file by problem; none without a file."""
    rows = json.loads(path.read_text(encoding="utf-8")) if path is not None else []
    return {row["problem"]: Compared(**row) for row in rows}


def text_of(found: Sequence[Compared]) -> str:
    """Return the table of all problems."""
    head = ["problem", "motors", "linkplan [s]", "status", "objective", "peer [s]", "peer's objective", "best known"]
    rows = []
    for one in found:
        peer = one.peer_objective if one.peer_objective is not None else one.peer_status or None
        over = None if one.over_best is None else round(100 * one.over_best, 4)
        row = [one.problem, one.motors, one.processor_s, one.status, one.objective, one.peer_processor_s, peer]
        rows.append([*row, one.best_known, over])
    return table([*head, "over the best [%]"], rows)


def draw(found: Sequence[Compared], path: Path) -> None:
    """Draw the processor time to a certified plan over the number of motors, and the peer's to its answer."""
    panels: Mapping[str, tuple[str, ...]] = {
        "least time": ("time", "payload", "speed"),
        "least effort, time and effort": ("effort11", "effort15", "mixed"),
    }
    with page(path, 1, len(panels), size=(10.0, 4.4), sharey=True) as axes:
        for ax, (title, kinds) in zip(axes[0], panels.items(), strict=True):
            of_kind = [one for one in found if one.kind in kinds]
            ours = [(one.motors, one.processor_s, one.status in _PASSED) for one in of_kind]
            peers = [(o.motors, o.peer_processor_s, o.peer_objective is not None) for o in of_kind if o.peer_processor_s]
            _draw_times(ax, ours, "linkplan, certified", BLUE, "o", -0.12)
            _draw_times(ax, peers, "casadi.Opti by hand, no certificate", ORANGE, "s", 0.12)
            ax.set(yscale="log", title=title, xlabel="motors", xticks=sorted({one.motors for one in found}))
            ax.yaxis.set_major_formatter("{x:g}")
        axes[0, 0].set_ylabel("processor time of the whole process [s]")
        axes[0, 0].legend(fontsize=8)


def _draw_times(ax, points: Sequence[tuple[int, float, bool]], label: str, colour: str, mark: str, aside: float) -> None:
    """Draw (motors, seconds, whether there is a motion): marks, crosses where there is none, a line through the medians."""
    for there, style in ((True, mark), (False, "x")):
        shown = [(motors + aside, seconds) for motors, seconds, passed in points if passed is there]
        if shown:
            words = label if there else f"{label.split(',')[0]}: no motion"
            ax.plot(*np.array(shown).T, style, color=colour, markersize=5, alpha=0.7, label=words)
    motors = sorted({point[0] for point in points if point[2]})
    medians = [np.median([seconds for n, seconds, passed in points if n == at and passed]) for at in motors]
    ax.plot(np.array(motors) + aside, medians, "-", color=colour)


def bench_many(folder: Path) -> str:
    """Plan the own robots beside the peer, write many.json and many.png into a folder, and return the table."""
    with tempfile.TemporaryDirectory() as place:
        found = compare_all(write_robots(Path(place)), peers={}, into=folder / "many.json")
    draw(found, folder / "many.png")
    return text_of(found)


def main(arguments: Sequence[str]) -> int:
    """Run the command line and return its exit code: 1 if a plan does not pass."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.many", description=bench_many.__doc__)
    parser.add_argument("folder", nargs="?", type=Path, help="of problem files NAME-KIND.toml; default: the own robots")
    parser.add_argument("--only", nargs="+", default=[""], metavar="WORD", help="problems whose name contains a word")
    parser.add_argument("--kinds", nargs="+", default=KINDS, choices=KINDS, help="kinds of problems")
    parser.add_argument("--empty-cache", action="store_true", help="each plan begins with an empty cache of compiled code")
    parser.add_argument("--no-peer", action="store_true", help="without the program by hand")
    parser.add_argument("--peer-of", type=Path, metavar="JSON", help="with the peer's answers of an earlier run")
    parser.add_argument("-o", "--output", type=Path, metavar="JSON", help="write, or with --draw read, the answers")
    parser.add_argument("--draw", type=Path, metavar="PNG", help="only draw the answers of -o")
    asked = parser.parse_args(arguments)
    if asked.draw:
        draw([*load_compared(asked.output).values()], asked.draw)
        return 0
    with tempfile.TemporaryDirectory() as place:
        problems = write_robots(Path(place), asked.kinds) if asked.folder is None else sorted(asked.folder.glob("*.toml"))
        chosen = [p for p in problems if p.stem.endswith(tuple(asked.kinds)) and any(word in p.stem for word in asked.only)]
        how = {"peers": load_compared(asked.peer_of), "no_peer": asked.no_peer, "empty_cache": asked.empty_cache}
        found = compare_all(chosen, **how, into=asked.output)
    print(text_of(found))
    return int(not found or any(one.status not in _PASSED for one in found))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
