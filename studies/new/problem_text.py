"""A problem file as text: the keys that are set, and every other key as a comment with its default and meaning."""

import re
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from linkplan.models.catalogue import MODELS
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled
from linkplan.models.poses.assembly import advance
from linkplan.models.tree.dynamics import site_names
from linkplan.models.tree.joints import Joint, unit_steps
from linkplan.planner.files.tables import inline, key_text
from linkplan.planner.keys.key_table import Key, key_table
from linkplan.planner.problem.sites import AXES
from linkplan.studies.new.first_motion import FirstMotion, relative_model_path

# The largest width of lines, and the column of the comments after values.
_LINE_WIDTH, _COMMENT_COLUMN = 100, 44
# A site that moves less [m] is no example for a motion.
_LEAST_SITE_TRAVEL_M = 1e-3
_HEAD = """\
# Keys that end in _deg are in degrees, those of slides (_m) in metres, all else is SI. To set a key
# remove the # of its line and of its section's line. The value there is the default, or an example
# if the comment names another default.
"""


def problem_text(mechanism: Mechanism, tables: Mapping[str, Mapping], description: str, begin: Sequence[str] = ()) -> str:
    """Return the text of a problem file.

    Args:
        mechanism: with the names for the examples.
        tables: the keys that are set.
        description: of the problem, in a sentence.
        begin: lines of comment at the top.
    """
    facts = _facts(mechanism)
    lines = [*(f"# {line}" for line in begin), _HEAD, f"description = {inline(description)}"]
    rows = key_table()
    for section in (row for row in rows if not row.section and row.name != "description"):
        head, doc = f"[{section.name}]", section.doc
        if section.name == "imperfections" and not tables.get(section.name):
            head, doc = f"#{head}", _said(section)  # an empty table would mean perfect machines
        lines += ["", *_laid_out(head, doc)]
        for key in (row for row in rows if row.section == section.name):
            lines += _lines(key, tables.get(section.name, {}), facts)
        if section.name == "motors":
            code = f"#{facts['actuator']} = {_filled(section.example, facts)}"
            of_one = [row for row in rows if row.section == "motors.NAME" and f"{row.name} =" in code]
            lines += _laid_out(code, "; ".join(f"{row.name}: {row.doc} [{row.unit}]" for row in of_one))
    return "\n".join(line.rstrip() for line in lines) + "\n"


def _lines(key: Key, section: Mapping, facts: Mapping) -> list[str]:
    """Return the lines of a key with its comment; no lines if the mechanism cannot have the key."""
    example = key.example if key.default is None else inline(key.default)
    if key.name in section:
        return _laid_out(f"{key.name} = {inline(section[key.name])}", _said(key).removesuffix("; required"))
    if not facts.keys() >= {*re.findall(r"\{(\w+)\}", example), *key.needs.split()}:
        return []
    return _laid_out(f"#{key.name} = {_filled(example, facts)}", _said(key))


def _said(key: Key) -> str:
    """Return the comment on a key: its meaning, unit and choices, and its default if the line does not show it."""
    unit = f" [{key.unit}]" if key.unit else ""
    choices = f"; {key.choices}" if key.choices else ""
    otherwise = "" if key.is_constant else "; required" if key.required else f"; default: {key.default_words}"
    return f"{key.doc}{unit}{choices}{otherwise}"


def _laid_out(code: str, doc: str) -> list[str]:
    """Return a line of TOML with its comment behind it or, if the line is long, above it."""
    if len(code) + 2 > _COMMENT_COLUMN:
        return [*textwrap.wrap(doc, _LINE_WIDTH, break_on_hyphens=False, initial_indent="# ", subsequent_indent="# "), code]
    first, *rest = textwrap.wrap(doc, _LINE_WIDTH - _COMMENT_COLUMN - 2, break_on_hyphens=False)
    return [f"{code.ljust(_COMMENT_COLUMN)}# {first}", *(f"{'':{_COMMENT_COLUMN}}# {more}" for more in rest)]


def _filled(text: str, facts: Mapping[str, str]) -> str:
    """Return a text with its placeholders, such as {hinge}, replaced by names of the mechanism."""
    for name, value in facts.items():
        text = text.replace(f"{{{name}}}", value)
    return text


def _facts(mechanism: Mechanism) -> dict[str, str]:
    """Return the values of the examples' placeholders as TOML; those that the mechanism has no object for are missing."""
    facts: dict[str, str] = {"independent": ", ".join(inline(joint.name) for joint in mechanism.independent_joints)}
    facts["joint"] = key_text(mechanism.independent_joints[0].name)
    facts["joint_name"] = inline(mechanism.independent_joints[0].name)
    facts |= _joint_facts(mechanism)
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
        facts["body"] = inline(bodies[-1])
    on_the_world = np.flatnonzero(mechanism.model.body_parentid == 0)[1:]
    facts["bodies"] = ", ".join(inline(mechanism.model.body(int(k)).name) for k in on_the_world)
    facts |= {"fully_driven": "fully_driven"} if mechanism.n_u == mechanism.dof else {}
    return facts


def _joint_facts(mechanism: Mechanism) -> dict:
    """Return name, home and range of the first hinge and slide, also among the independent joints, and a waypoint."""
    facts: dict = {}
    free = mechanism.independent.tolist()
    for kind in ("hinge", "slide"):
        for name, order in ((f"free_{kind}", free), (kind, [*free, *mechanism.dependent.tolist()])):
            index = next((i for i in order if mechanism.joints[i].kind == kind), None)
            if index is not None:
                joint = mechanism.joints[index]
                facts[name] = key_text(joint.name)
                facts[f"{name}_home"] = inline(_shown(joint, float(mechanism.home[index])))
                facts[f"{name}_range"] = inline([_shown(joint, joint.lower), _shown(joint, joint.upper)])
    for kind, key in (("slide", "at_m"), ("hinge", "at_deg")):
        if f"free_{kind}" in facts:
            facts["waypoint"] = f"{key} = {{ {facts[f'free_{kind}']} = {facts[f'free_{kind}_home']} }}"
    return facts


def _place(mechanism: Mechanism) -> tuple[str, str] | None:
    """Return the site that moves most next to home, and its position there on an axis for each freedom, as TOML."""
    names = site_names(mechanism.model)
    s = mechanism.home[mechanism.independent]
    steps = np.diag(unit_steps(mechanism.independent_joints, mechanism.extent_m))
    poses = np.vstack([mechanism.home, *(advance(mechanism, mechanism.home, s + 0.1 * step)[0] for step in steps)])
    places = sampled(mechanism.dynamics.site_places, poses)[:, :, [mechanism.model.site(name).id for name in names]]
    spans = np.ptp(places, axis=0)
    if spans.max(initial=0.0) < _LEAST_SITE_TRAVEL_M:
        return None
    farthest = int(np.argmax(spans.max(axis=0)))
    name, span, home = names[farthest], spans[:, farthest], places[0, :, farthest]
    chosen = sorted(np.argsort(-span)[: min(mechanism.dof, int(np.sum(span > _LEAST_SITE_TRAVEL_M)))])
    return key_text(name), inline({AXES[k]: round(float(home[k]), 4) + 0.0 for k in chosen})


def _shown(joint: Joint, position: float) -> float:
    """Return a position in the unit of files, rounded to six digits."""
    return float(f"{joint.shown(position):.6g}") + 0.0


def file_tables(found: FirstMotion, model: str, target: Path | None) -> dict[str, dict]:
    """Return the tables of a first motion's file at `target`."""
    tables = found.tables
    if model not in MODELS:
        tables = tables | {"mechanism": tables["mechanism"] | {"model": relative_model_path(model, target)}}
    return tables


def first_text(found: FirstMotion, tables: dict[str, dict], steps: tuple[str, str]) -> str:
    """Return the commented text of a first motion's file; `steps` are how to plan it and how to track the plan."""
    plans, tracks = steps
    begin = [
        plans.ljust(42) + "plans it, certifies it between the nodes and saves it",
        tracks.ljust(42) + "tracks it in MuJoCo by PD, PD + feedforward and LQR",
        "",
        *(line for note in found.changed for line in [*textwrap.wrap(f"CHANGED: {note}", 98), ""]),
    ]
    return problem_text(found.mechanism, tables, found.description, begin)
