"""A problem file as text: what is set, and every other key in a comment with its default, what it means beside it."""

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.models.poses.reach import reach
from linkplan.models.tree.joints import Joint
from linkplan.models.tree.sites import site_names
from linkplan.planner.files.examples import EXAMPLES, NEEDS, Example
from linkplan.planner.files.toml_text import inline, key_text
from linkplan.planner.keys.key_table import Key, key_table
from linkplan.planner.problem.sites import AXES

# What no line of comments exceeds, and the column where they begin beside a value.
_WIDTH, _COLUMN = 100, 44
# Decimals of a metre of a site's place, and how far [m] one has to move to be one that a motion can be asked for.
_SITE_DIGITS, _MOVES_M = 4, 1e-3
_HEAD = """\
# Keys that end in _deg are in degrees, those of slides (_m) in metres, all else is SI. To set a key
# take the # from its line: behind it stands the default, or an example where another is named.
"""


def problem_text(mechanism: Mechanism, tables: Mapping[str, Mapping], description: str, begin: Sequence[str] = ()) -> str:
    """Return the text of a problem file.

    Args:
        mechanism: whose names the examples have.
        tables: what is set.
        description: of the problem, in a sentence.
        begin: lines of comment to begin with.
    """
    facts = _facts(mechanism)
    lines = [*(f"# {line}" for line in begin), _HEAD, f"description = {inline(description)}"]
    rows = key_table()
    for section in (row for row in rows if not row.section and row.name != "description"):
        lines += ["", f"[{section.name}]".ljust(_COLUMN) + f"# {section.doc}"]
        for key in (row for row in rows if row.section == section.name):
            lines += _lines(key, tables.get(section.name, {}), facts)
        if section.name == "motors":
            code = f"#{facts['actuator']} = {_filled(EXAMPLES['motors.{actuator}'].text, facts)}"
            of_one = [row for row in rows if row.section == "motors.NAME" and f"{row.name} =" in code]
            lines += _laid_out(code, "; ".join(f"{row.name}: {row.doc} [{row.unit}]" for row in of_one))
    return "\n".join(line.rstrip() for line in lines) + "\n"


def _lines(key: Key, section: Mapping, facts: Mapping) -> list[str]:
    """Return a key's line, its comment beside it where there is room, else above; none of what a mechanism cannot have."""
    path = f"{key.section}.{key.name}"
    example = EXAMPLES[path] if key.default is None else Example(text=inline(key.default))
    if key.name in section:
        return _laid_out(f"{key.name} = {inline(section[key.name])}", _said(key).removesuffix("; required"))
    if not facts["has"].issuperset(example.needs):
        return []
    return _laid_out(f"#{key.name} = {_filled(example.text, facts)}", _said(key))


def _said(key: Key) -> str:
    """Return what is said of a key: its meaning, unit and choices, and its default where no line of its own shows it."""
    unit = f" [{key.unit}]" if key.unit else ""
    choices = f"; {key.choices}" if key.choices else ""
    otherwise = "" if key.is_constant else "; required" if key.required else f"; default: {key.default_words}"
    return f"{key.doc}{unit}{choices}{otherwise}"


def _laid_out(code: str, doc: str) -> list[str]:
    """Return a line of TOML and its comment, which stands above it where there is no room beside it."""
    if len(code) + 2 > _COLUMN:
        return [*textwrap.wrap(doc, _WIDTH, break_on_hyphens=False, initial_indent="# ", subsequent_indent="# "), code]
    first, *rest = textwrap.wrap(doc, _WIDTH - _COLUMN - 2, break_on_hyphens=False)
    return [f"{code.ljust(_COLUMN)}# {first}", *(f"{'':{_COLUMN}}# {more}" for more in rest)]


def _filled(text: str, facts: Mapping) -> str:
    """Return a text with what it names of a mechanism in braces, as {hinge}, filled in."""
    for name, value in facts.items():
        text = text.replace(f"{{{name}}}", value) if isinstance(value, str) else text
    return text


def _facts(mechanism: Mechanism) -> dict:
    """Return what examples name of a mechanism, as TOML, and which of `NEEDS` it has under "has"."""
    facts: dict = {"independent": ", ".join(inline(joint.name) for joint in mechanism.independent_joints)}
    facts["joint"] = key_text(mechanism.independent_joints[0].name)
    facts["joint_name"] = inline(mechanism.independent_joints[0].name)
    free = mechanism.independent.tolist()
    for kind in ("hinge", "slide"):
        for name, order in ((f"free_{kind}", free), (kind, [*free, *mechanism.dependent.tolist()])):
            index = next((i for i in order if mechanism.joints[i].kind == kind), None)
            if index is not None:
                joint = mechanism.joints[index]
                facts[name] = key_text(joint.name)
                facts[f"{name}_home"] = inline(_shown(joint, mechanism.home[index]))
                facts[f"{name}_range"] = inline([_shown(joint, joint.lower), _shown(joint, joint.upper)])
    for kind, key in (("slide", "at_m"), ("hinge", "at_deg")):
        if f"free_{kind}" in facts:
            facts["waypoint"] = f"{key} = {{ {facts[f'free_{kind}']} = {facts[f'free_{kind}_home']} }}"
    if mechanism.actuators:
        first = mechanism.actuators[0]
        facts |= {"actuator": key_text(first.name), "effort_range": inline([first.lower, first.upper])}
        facts["effort_high"] = inline(max(abs(first.lower), abs(first.upper)) if np.isfinite(first.upper) else 100.0)
        facts["no_load"] = "no_load_speed_m_s = 1.0" if first.unit == "N" else "no_load_speed_deg_s = 3600.0"
    if mechanism.closure_names:
        facts["closure"] = key_text(mechanism.closure_names[0])
    place = _place(mechanism)
    if place is not None:
        facts["site"], facts["site_home"] = place
    bodies = [name for k in range(1, mechanism.model.nbody) if (name := mechanism.model.body(k).name)]
    if bodies:
        facts["body"], facts["body_name"] = bodies[-1], inline(bodies[-1])
    facts |= {"fully_driven": "fully_driven"} if mechanism.n_u == mechanism.dof else {}
    facts["has"] = {need for need in NEEDS if need in facts}
    return facts


def _place(mechanism: Mechanism) -> tuple[str, str] | None:
    """Return the site that moves most and where it is at home, as TOML; as many coordinates as there are freedoms."""
    poses = np.vstack([reach(mechanism, column).poses for column in range(mechanism.dof)])
    found = []
    for name in site_names(mechanism.model):
        index = int(mechanism.model.site(name).id)
        span = np.ptp(places_of(mechanism, index, poses), axis=0)
        found.append((float(span.max()), name, index, span))
    if not found or max(found, key=lambda one: one[0])[0] < _MOVES_M:
        return None
    _, name, index, span = max(found, key=lambda one: one[0])
    home = places_of(mechanism, index, mechanism.home)[0]
    chosen = sorted(np.argsort(-span)[: min(mechanism.dof, int(np.sum(span > _MOVES_M)))])
    return key_text(name), inline({AXES[k]: round(float(home[k]), _SITE_DIGITS) + 0.0 for k in chosen})


def _shown(joint: Joint, position: float) -> float:
    """Return a position in the unit of files, in digits that read well."""
    return float(f"{joint.shown(position):.6g}") + 0.0
