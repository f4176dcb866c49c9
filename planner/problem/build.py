"""From the tables of a problem file to the arguments of a `Problem`, with every key and value checked.

Builders, files and saved plans all make tables. The sections of `planner.problem.keys` are their specification, and each
section becomes the value of one field here. Angles are in degrees with `_deg` in the key, positions of slides in metres with
`_m`; all else is SI.

The builders `Problem.reach`, `hold`, `periodic` and `track` first write their arguments into such tables.
"""

import copy
import functools
import inspect
import os
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs

from linkplan.models.audit import audit
from linkplan.models.catalogue import MODELS
from linkplan.models.errors import ModelError, ProblemError, nearest
from linkplan.models.mechanism import Mechanism, load_mechanism, loading_arguments
from linkplan.models.poses.body_angles import body_index
from linkplan.models.selection import Selection
from linkplan.models.tree.dynamics import site_index
from linkplan.planner.files.columns import read_csv
from linkplan.planner.files.tables import Tables, resolve_path, set_key, toml_text
from linkplan.planner.problem.consistency import no_actuator, rest_notes
from linkplan.planner.problem.extra import Extra, ExtraCost, extras_text
from linkplan.planner.problem.force_table import force_notes, force_rows, forces_of
from linkplan.planner.problem.imperfections import imperfections_of
from linkplan.planner.problem.instant import Robust
from linkplan.planner.problem.keys.reading import KEYS, checked, kind_of, read, refuse_unknown_keys
from linkplan.planner.problem.keys.sections import (
    DEFAULT_PERIOD_S,
    JERK_SCHEME,
    PATH_INTERVALS,
    GuessSection,
    MechanismSection,
    MotionSection,
    ObjectiveSection,
    ProblemFile,
    TrackingSection,
)
from linkplan.planner.problem.limits import actuator_index, closure_index, limits_from, motors_of, pin_or_closure
from linkplan.planner.problem.motion_table import motion_of
from linkplan.planner.problem.objective import Objective, objective_from
from linkplan.planner.problem.parameters import (
    box_of,
    parameter_values,
    ranges_of,
    read_parameters,
    refuse_two_values,
)
from linkplan.planner.problem.path import path_rows, site_path_of
from linkplan.planner.problem.reference import Reference, guess_of, reference_of, repeats_in
from linkplan.planner.problem.settings import (
    MeshSettings,
    SolverSettings,
    Tracking,
    coordinates_note,
    joint_values,
    other_coordinates,
    to_toml_types,
)
from linkplan.planner.problem.table_reference import reference_rows

# Tables that may name a CSV file in place of some keys: these keys, and the function that makes them from its columns.
_FILES: dict[str, tuple[tuple[str, ...], Callable[[dict[str, np.ndarray], str, Mechanism], dict[str, Any]]]] = {
    "reference": (("time_s", "position_deg", "position_m", "at", "body_deg"), reference_rows),
    "force_over_time": (("time_s", "on"), force_rows),
    "path": (("points",), path_rows),
}
# Arguments that are whole tables of a problem file, arguments that are keys of a table, and arguments that no file has.
_SECTIONS = tuple(name for name in ProblemFile.__struct_fields__ if name not in ("mechanism", "motion", "objective"))
_OF_OTHERS = {"minimize": "objective", "reserve": "limits", "sites": "output"}
_TABLES = {key: "motion" for key in KEYS["motion"] if key != "kind"} | _OF_OTHERS
MECHANISM_ARGUMENTS = tuple(key for key in KEYS["mechanism"] if key != "model")
_EXTRAS = {
    "extra_costs": "A list of `ExtraCost`, running costs in addition to `minimize`, or the whole objective if that is {}.",
    "extra_limits": "A list of `ExtraLimit`, limits at every instant.",
}
_OWN = {
    "mechanism": "From `load_mechanism`, or an argument for it: a built-in name, a path, MJCF text.",
    "name": "In messages, tables and files. Default: the mechanism's name with the kind of motion.",
}
# The arguments of builders.
ARGUMENTS = ("mechanism", *_TABLES, *_SECTIONS, *_EXTRAS, "name", *MECHANISM_ARGUMENTS)


def values_of(
    described: Mapping[str, Any],
    folder: Path | None,
    mechanism: Mechanism | None,
    extra_costs: Sequence[ExtraCost],
) -> dict[str, Any]:
    """Return the values of a `Problem` that follow from a file's tables: its decoded sections, and what they mean in SI.

    Args:
        described: the tables of a problem file.
        folder: in which paths are looked up before the working folder.
        mechanism: a loaded one that replaces [mechanism].
        extra_costs: terms of the objective that are not in the tables.
    """
    tables: Tables = to_toml_types(described)
    if mechanism is not None:
        tables["mechanism"] = table_of(mechanism)
        if named := parameters_of(mechanism) | tables.get("parameters", {}):
            tables["parameters"] = named
            refuse_two_values(tables["mechanism"], named)
            if (values := parameter_values(named)) != parameter_values(parameters_of(mechanism)):
                mechanism = mechanism.with_parameters(values)
            mechanism = replace(mechanism, source={**mechanism.source, "parameters": named})
    refuse_unknown_keys(tables)
    if mechanism is None:
        mechanism = _mechanism(tables.setdefault("mechanism", {}), folder, tables.get("parameters", {}))
    if mechanism.n_u == 0:
        raise ProblemError(no_actuator(mechanism) + "".join(f"; {item.text}" for item in audit(mechanism.model)))
    _replace_files(tables, mechanism, folder)
    asked = _sections(tables, mechanism)
    notes = []
    others = other_coordinates(tables, mechanism)
    if others is not None:
        notes.append(coordinates_note(mechanism, others))
        mechanism = _in_coordinates(tables, mechanism, others, folder)
        asked = asked.replace(mechanism=asked.mechanism.replace(independent=others))
    limits = limits_from(asked.limits, mechanism)
    reference, path, guess = None, None, None
    if asked.reference is not None:
        reference, reference_notes = reference_of(asked.reference, mechanism, limits.position)
        notes += reference_notes
    if asked.path is not None:
        smooth = bool(limits.site_jerk) or bool(np.any(np.isfinite(limits.jerk)))
        path = site_path_of(asked.path, mechanism, smooth=smooth)
    motion = motion_of(asked.motion, mechanism, reference, limits, path)
    forces = None if asked.force_over_time is None else forces_of(asked.force_over_time, mechanism, motion, reference)
    if asked.force_over_time is not None:
        notes += force_notes(asked.force_over_time)
    if forces is not mechanism.forces:
        mechanism = replace(mechanism, forces=forces)
    minimize: Any = _default_term(asked, reference) if asked.objective.minimize is None else asked.objective.minimize
    objective = objective_from(minimize, extra_costs)
    for name in asked.output.sites:
        site_index(mechanism.model, name, "output.sites", ProblemError)
    if asked.guess != GuessSection():
        guess, place = guess_of(asked.guess, mechanism, folder)
        asked = asked if place is None else asked.replace(guess=asked.guess.replace(plan=str(place)))
    asked = _without_defaults(asked, mechanism, reference)
    return {
        "sections": asked,
        "mechanism": mechanism,
        "motion": motion,
        "path": path,
        "objective": objective,
        "limits": limits,
        "robust": Robust(**structs.asdict(asked.robust), box=box_of(asked, mechanism)),
        "motors": motors_of(asked.motors, mechanism),
        "reference": reference,
        "guess": guess,
        "mesh": MeshSettings(**_mesh(asked, objective)),
        "solver": SolverSettings(**structs.asdict(asked.solver)),
        "tracking": _tracking(asked.tracking, mechanism).tracked(),
        "notes": (*notes, *_duration_notes(asked.motion, objective, reference), *rest_notes(motion, mechanism, limits)),
    }


def _default_term(asked: ProblemFile, reference: Reference | None) -> str:
    return "tracking" if asked.motion.kind == "track" or reference is not None else "effort"


def _without_defaults(asked: ProblemFile, mechanism: Mechanism, reference: Reference | None) -> ProblemFile:
    """Return sections without values that are the defaults of this problem, so that equal problems have equal sections."""
    if asked.objective.minimize == _default_term(asked, reference):
        asked = asked.replace(objective=asked.objective.replace(minimize=None))
    if asked.motion.duration_s == ("free" if reference is None else reference.period_s):
        asked = asked.replace(motion=asked.motion.replace(duration_s=None))
    if asked.tracking.period_s == default_period(mechanism):
        asked = asked.replace(tracking=asked.tracking.replace(period_s=None))
    return asked


def _replace_files(tables: Tables, mechanism: Mechanism, folder: Path | None) -> None:
    """Replace the CSV file that a table names by its rows, so that a saved problem needs no other file."""
    for key, (replaced, rows_of) in _FILES.items():
        section = tables.get(key)
        if not isinstance(section, Mapping) or "file" not in section:
            continue
        also = [one for one in replaced if one in section]
        if also:
            raise ProblemError(f"{key}.file and {key}.{also[0]} both give the table; keep one")
        name = checked(f"{key}.file", section["file"])
        what = f"{key}.file '{name}'"
        rows = rows_of(read_csv(resolve_path(name, folder), what), what, mechanism)
        tables[key] = {one: value for one, value in section.items() if one != "file"} | rows


def mechanism_from_tables(tables: Mapping[str, dict], folder: Path | None = None) -> Mechanism:
    """Return the mechanism of a file's [mechanism] table; the other tables are only checked for unknown keys."""
    tables = to_toml_types(tables)
    refuse_unknown_keys(tables)
    return _mechanism(tables.get("mechanism", {}), folder, tables.get("parameters", {}))


def tracking_from_tables(tables: Mapping[str, dict], mechanism: Mechanism | None = None) -> Tracking:
    """Return the tracking settings of a file's [tracking] table; with a mechanism, gains by joint are checked."""
    tables = to_toml_types(tables)
    refuse_unknown_keys(tables)
    return _tracking(read(TrackingSection, tables.get("tracking", {}), "tracking"), mechanism)


def _sections(tables: Tables, mechanism: Mechanism) -> ProblemFile:
    """Return the decoded sections of a file."""
    # An empty reference is none. An empty objective is legal with extra costs only, and `Objective` checks it.
    left_out = {"reference": {}, "objective": {"minimize": {}}}
    given = {name: table for name, table in tables.items() if table != left_out.get(name)}
    asked = read(ProblemFile, given, "", functools.partial(_refuse_unknown_name, mechanism))
    if asked.imperfections is not None:
        imperfections_of(tables["imperfections"], mechanism)
    empty = tables.get("objective") == left_out["objective"]
    return asked.replace(objective=ObjectiveSection(minimize={})) if empty else asked


def _refuse_unknown_name(mechanism: Mechanism, noun: str, name: str, where: str) -> None:
    """Refuse a name of a joint, actuator, closure, site or body that the mechanism does not have."""
    if noun == "joint":
        mechanism.joint_index(name, ProblemError)
    elif noun == "site":
        if name not in [joint.name for joint in mechanism.joints]:  # a joint's name gets its own message elsewhere
            site_index(mechanism.model, name, where, ProblemError)
    elif noun == "body":
        body_index(mechanism.model, name, where, ProblemError)
    elif noun == "closure":
        closure_index(mechanism, name)
    elif noun == "pin":
        pin_or_closure(mechanism, name)
    else:
        actuator_index(mechanism, name, where)


def model_from_tables(tables: Mapping[str, dict], folder: Path | None = None) -> tuple[str, Selection]:
    """Return the model of a file's [mechanism] table, a built-in name or a path, and what is selected of it."""
    _, selection = _model_asked(section := to_toml_types(tables).get("mechanism", {}), folder)
    return section["model"], selection


def _model_asked(section: dict, folder: Path | None) -> tuple[MechanismSection, Selection]:
    """Return a [mechanism] table and what it selects of the model, whose file is set in the table as an absolute path."""
    # Errors in the model's path and pose are problem errors; all others are model errors.
    read(MechanismSection, {key: section[key] for key in ("model", "home_deg", "home_m") if key in section}, "mechanism")
    asked = read(MechanismSection, section, "mechanism", error=ModelError)
    place = resolve_path(asked.model, folder)
    if asked.model not in MODELS and os.path.isfile(place):
        section["model"] = str(place.resolve())
    given = asked.to_dict()
    return asked, Selection(**{field.name: given[field.name] for field in fields(Selection) if field.name in given})


def _mechanism(section: dict, folder: Path | None, parameters: Mapping[str, Any]) -> Mechanism:
    asked, selection = _model_asked(section, folder)
    refuse_two_values(section, parameters)
    own = {"payload": section.get("payload"), "selection": selection, "parameters": parameter_values(parameters)}
    mechanism = load_mechanism(section["model"], **own, **loading_arguments(asked.to_dict()))
    ranges_of(read_parameters(parameters), mechanism)
    joint_values(asked, "home", "mechanism", mechanism)  # raises an error for degrees on a slide and metres on a hinge
    named = {"parameters": dict(parameters)} if parameters else {}
    return replace(mechanism, source=asked.replace(model=section["model"]).to_dict() | named)


def _in_coordinates(tables: Tables, mechanism: Mechanism, named: list[str], folder: Path | None) -> Mechanism:
    """Return a mechanism with other independent coordinates, and set them in the tables."""
    tables["mechanism"]["independent"] = named
    try:
        return _mechanism(tables["mechanism"], folder, tables.get("parameters", {}))
    except ModelError as error:
        had = ", ".join(joint.name for joint in mechanism.independent_joints)
        raise ProblemError(
            f"the motion names {', '.join(named)}, but cannot be planned in these joints; name {had} instead: {error}"
        ) from error


def _duration_notes(motion: MotionSection, objective: Objective, reference: Reference | None) -> list[str]:
    """Return a note if the duration is free by default, or if it ends within a period of the reference."""
    given = motion.duration_s
    if motion.kind == "track" and isinstance(given, float) and reference is not None and reference.periodic:
        periods = given / reference.period_s
        part = (
            f"motion.duration_s = {given:g} s is {periods:.4g} periods of the reference, of {reference.period_s:g} s each:"
        )
        return [] if repeats_in(reference, given) else [f"{part} the motion ends within a period, and does not repeat"]
    is_given = any(value is not None for value in (motion.duration_s, motion.min_duration_s, motion.max_duration_s))
    if is_given or reference is not None or objective.has("time"):
        return []
    return ["the duration is free (motion.duration_s sets it)"]


def _mesh(asked: ProblemFile, objective: Objective) -> dict:
    """Return the mesh settings, with defaults that depend on the rest of the problem."""
    section = asked.mesh.to_dict()
    # A motion of least work consists of full effort, coasting and full braking. A polynomial cannot represent these jumps,
    # and the work is evaluated only at nodes. Efforts with limited rates cannot jump, so they are piecewise linear.
    smeared = objective.has("work") and {*objective.weights} <= {"work", "time"}
    values: dict = {"effort": "linear" if asked.limits.effort_rate else "constant"} if smeared else {}
    if asked.path is not None and "breaks" not in section:
        values["intervals"] = PATH_INTERVALS
    if objective.has("jerk"):
        values["scheme"] = JERK_SCHEME
    if "scheme" in section:
        values["refine"] = "intervals"  # a named transcription is kept, unless the refinement is also given
    if "breaks" in section and "intervals" in section:
        raise ProblemError("mesh.breaks and mesh.intervals both give the number of intervals; keep one")
    return values | section


def _tracking(section: TrackingSection, mechanism: Mechanism | None) -> Tracking:
    found = Tracking(**{"period_s": default_period(mechanism)} | section.to_dict())
    if mechanism is not None:
        # Both refuse joints without a value, and values of unknown joints.
        zero = {key: 0.0 for key in ("kp", "kd") if getattr(found, key) is None}
        found.replace(**zero).gains(mechanism.independent_joints)
        found.lqr_errors(mechanism.independent_joints)
    return found


def default_period(mechanism: Mechanism | None) -> float:
    """Return the default control period [s]: `DEFAULT_PERIOD_S`, or the model's timestep if that is longer."""
    return max(DEFAULT_PERIOD_S, 0.0 if mechanism is None else float(mechanism.model.opt.timestep))


def with_arguments(function: Callable, names: Sequence[str] = ARGUMENTS) -> Callable:
    """Return a function whose signature and documentation have arguments that are keys of files, for help and editors."""
    signature, text = inspect.signature(function), inspect.cleandoc(function.__doc__ or "")
    own = [one for one in signature.parameters.values() if one.kind is not one.VAR_KEYWORD]
    named = [name for name in names if name not in signature.parameters]
    every = [*own, *(inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None) for name in named)]
    function.__signature__ = signature.replace(parameters=every)
    if "Args:" not in text:
        rows = (textwrap.fill(f"{name}: {_meaning(name)}", 100, subsequent_indent=" " * 4) for name in names)
        head, raises, rest = text.partition("\n\nRaises:")
        arguments = textwrap.indent("\n".join(rows), " " * 4)
        function.__doc__ = f"{head}\n\nArgs:\n{arguments}\n{raises}{rest}"
    return function


def _meaning(argument: str) -> str:
    """Return the sentence on an argument: that of its key in problem files."""
    if argument in (_EXTRAS | _OWN):
        return (_EXTRAS | _OWN)[argument]
    section = _TABLES.get(argument, "mechanism" if argument in MECHANISM_ARGUMENTS else "")
    about = kind_of(f"{section}.{argument}" if section else argument).__metadata__
    return next(meta.description for meta in about if meta.description)


def refuse_unknown_arguments(said: Mapping[str, object], builder: str) -> None:
    """Refuse names that are not arguments of a builder; `replace` takes all sections."""
    for key in said:
        if key not in ARGUMENTS and not (builder == "replace" and key in KEYS):
            hint = nearest(key, ARGUMENTS)
            raise ProblemError(f"unknown argument '{key}' of {builder}{hint}; arguments are {', '.join(ARGUMENTS)}")


def fill(tables: Tables, said: Mapping[str, object]) -> None:
    """Set arguments in a file's tables; None removes what was set before."""
    sections = (*_SECTIONS, "motion", "objective")
    for name in sorted(said, key=lambda name: name not in sections):  # whole tables before keys in them
        if name in sections or name in _TABLES:
            table = tables if name in sections else tables.setdefault(_TABLES[name], {})
            table.pop(name, None)
            if said[name] is not None:
                table[name] = to_toml_types(said[name])


def apply_settings(tables: Tables, settings: object) -> None:
    """Set single values in a file's tables, by dotted key; None removes one."""
    if not isinstance(settings, Mapping):
        raise ProblemError(f"settings must be a table of section.key = value, got {settings!r}")
    for key, value in settings.items():
        set_key(tables, str(key), to_toml_types(value))


def asked_mechanism(said: Mapping[str, object], default: Mechanism | None = None) -> Mechanism:
    """Return the mechanism of the argument `mechanism`, or the default, with the other arguments of a mechanism."""
    found = said.get("mechanism")
    if found is None and default is not None:
        found = default
    if not isinstance(found, Mechanism):
        found = to_toml_types(found)
        found = mechanism_from_tables({"mechanism": found if isinstance(found, dict) else {"model": found}})
    asked = {key: to_toml_types(value) for key, value in said.items() if key in MECHANISM_ARGUMENTS}
    table = {key: value for key, value in (table_of(found) | asked).items() if value is not None}
    return mechanism_from_tables({"mechanism": table, "parameters": parameters_of(found)}) if asked else found


def table_of(mechanism: Mechanism) -> dict:
    """Return a mechanism as a table [mechanism]."""
    return copy.deepcopy({key: value for key, value in mechanism.source.items() if key != "parameters"})


def parameters_of(mechanism: Mechanism) -> dict:
    """Return the parameters of a mechanism as a table [parameters]."""
    named = mechanism.source.get("parameters", {})
    return {name: {} if given is None else copy.deepcopy(given) for name, given in named.items()}


def given_extras(said: Mapping[str, object]) -> dict:
    """Return the arguments that are Python code, which tables cannot hold."""
    return {key: () if said[key] is None else said[key] for key in _EXTRAS if key in said}


def checked_name(name: object) -> str:
    """Return a problem's name if it can be shown."""
    if not isinstance(name, str) or not name.strip() or not name.isprintable() or len(name) > 500:
        raise ProblemError(f"a problem's name must have 1 to 500 printable characters, got {name!r}")
    return name


def file_text(tables: Tables, extras: Sequence[Extra]) -> str:
    """Return a problem's tables as a file's text; a comment names extra limits and costs, which files cannot hold.

    Raises:
        ProblemError: for a value that TOML cannot express.
    """
    text = toml_text(tables)
    return f"# Without {extras_text(extras)}: a problem file cannot contain Python code.\n{text}" if extras else text
