"""The findings of `linkplan check` in at most thirty lines: the mechanism, its problems, the next step."""

from collections.abc import Iterable, Sequence

import mujoco

from linkplan.models.errors import listed, shortened
from linkplan.models.mechanism import Mechanism
from linkplan.studies.check.drives import floating_columns
from linkplan.studies.check.inspection import Inspection
from linkplan.studies.check.inspection_blocks import headline, reach_table
from linkplan.studies.output.document import Block, Facts, Text
from linkplan.studies.output.text import by_kind, limits_text

# Largest numbers of problems, coordinates and notes: the summary, with two lines on the next step, fits on a screen.
MOST_PROBLEMS, MOST_COORDINATES, MOST_NOTES = 7, 8, 4
# A sentence of the summary is cut at this length, so that it takes at most three lines of a narrow terminal.
_MOST_CHARACTERS = 240


def summary_blocks(found: Inspection) -> list[Block]:
    """Return the summary, which leaves room for lines on the next step."""
    mechanism = found.mechanism
    problems = grouped(mechanism, found.problems)
    verdict: list[Block] = [
        Text(text=f"PROBLEM: {text}", tone="bad") for text in _first(problems, MOST_PROBLEMS, "problems")
    ]
    notes = [Text(text=text, tone="note") for text in _first(grouped(mechanism, found.notes), MOST_NOTES, "notes")]
    drives = listed([f"{a.name} ({limits_text(a.lower, a.upper, a.unit)})" for a in mechanism.actuators], MOST_COORDINATES)
    rank = f"{mechanism.n_closure_rows} rows of rank {len(mechanism.closure_rows)}"
    facts = Facts(
        rows=[
            ("loops", f"{listed(mechanism.closure_names, MOST_COORDINATES)}: {rank}" if mechanism.closure_names else "none"),
            ("driven by", drives or "nothing"),
        ]
    )
    first = headline(mechanism, MOST_COORDINATES)
    return [first, *(verdict or [Text(text="no problems found", tone="good")]), facts, *_reaches(found), *notes]


def grouped(mechanism: Mechanism, sentences: Iterable[str]) -> list[str]:
    """Return one sentence of each kind, with the number of the others; a kind is the same but for names and numbers."""
    said = []
    for alike in by_kind(sentences, _names(mechanism)):
        more = f" (and {len(alike) - 1} more of this kind)" if len(alike) > 1 else ""
        said.append(shortened(alike[0], _MOST_CHARACTERS - len(more)) + more)
    return said


def _names(mechanism: Mechanism) -> set[str]:
    model = mechanism.model
    sizes = {
        mujoco.mjtObj.mjOBJ_BODY: model.nbody,
        mujoco.mjtObj.mjOBJ_GEOM: model.ngeom,
        mujoco.mjtObj.mjOBJ_SITE: model.nsite,
        mujoco.mjtObj.mjOBJ_JOINT: model.njnt,
        mujoco.mjtObj.mjOBJ_ACTUATOR: model.nactuator,
        mujoco.mjtObj.mjOBJ_EQUALITY: model.neq,
        mujoco.mjtObj.mjOBJ_TENDON: model.ntendon,
    }
    names = {mujoco.mj_id2name(model, kind, i) for kind, size in sizes.items() for i in range(size)}
    return names | {joint.name for joint in mechanism.joints} | set(mechanism.closure_names)


def _first(sentences: Sequence[str], most: int, what: str) -> list[str]:
    """Return the first sentences, and one that states how many were omitted."""
    if len(sentences) <= most:
        return list(sentences)
    return [*sentences[: most - 1], f"{len(sentences) - most + 1} more kinds of {what}"]


def _reaches(found: Inspection) -> list[Block]:
    """Return the table of the first coordinates' reach, without a floating base and rods' spins."""
    mechanism, floating = found.mechanism, floating_columns(found.mechanism)
    grounded = [can for can in found.reaches if can.coordinate not in floating]
    of = [can for can in grounded if mechanism.actuated[can.coordinate]]
    more = f"; the first {MOST_COORDINATES} of {len(of)} coordinates" if len(of) > MOST_COORDINATES else ""
    return [reach_table(found, of[:MOST_COORDINATES], more)] if of else []
