"""A problem file as text: what is set, and every other key in a comment with its default, what it means beside it."""

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.models.poses.reach import reach
from linkplan.models.tree.joints import Joint
from linkplan.models.tree.sites import site_names
from linkplan.planner.files.key_table import KEYS, NEEDS, SECTIONS, Key
from linkplan.planner.files.toml_text import inline, key_text
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
    for section, what in SECTIONS.items():
        lines += ["", f"[{section}]".ljust(_COLUMN) + f"# {what}"]
        for key in KEYS:
            if key.section == section and all(need in facts["has"] for need in key.needs):
                lines += _lines(key, tables.get(section, {}), facts)
    return "\n".join(line.rstrip() for line in lines) + "\n"


def _lines(key: Key, section: Mapping, facts: Mapping) -> list[str]:
    """Return a key's line, its comment beside it where there is room, else above."""
    name = _filled(key.key, facts)
    if key.key in section:
        code = f"{name} = {inline(section[key.key])}"
        doc = key.doc
    else:
        code = f"#{name} = {_filled(key.example, facts)}"
        doc = f"{key.doc}; default: {key.otherwise}" if key.otherwise else key.doc
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
    facts["independent_joint"] = key_text(mechanism.independent_joints[0].name)
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
        facts["body"] = bodies[-1]
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
