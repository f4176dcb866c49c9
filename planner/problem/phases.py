"""A motion in phases: its sections, and the ordinary problem of each phase.

A phase is a mechanism with its own closures: a foot on the ground is one more `connect`. The problem of a phase is the one
that a file with `mechanism.stand`, `mechanism.open` and `limits.friction` has, from one pose to another. What links the
phases is not part of it.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from linkplan.models.errors import ProblemError, choose
from linkplan.models.ground import ground_of
from linkplan.models.mechanism import Mechanism
from linkplan.planner.files.tables import Tables, read_tables, toml_text
from linkplan.planner.problem.build import apply_settings, checked_name, mechanism_from_tables, table_of
from linkplan.planner.problem.keys.phases import ContactSection, PhasedFile
from linkplan.planner.problem.keys.phases import PhaseSection as Phase
from linkplan.planner.problem.keys.reading import read
from linkplan.planner.problem.settings import joint_values, to_toml_types

# Sites that touch down may be below the ground by this share of the mechanism's size: a wall exactly where a phase ends
# would leave a solver no room.
_DEPTH_SHARE = 1e-4
# The tables that a phase's problem has from the whole file.
_COMMON = ("parameters", "motors", "mesh", "solver", "tracking", "output")


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PhasedProblem:
    """A motion of one mechanism in phases with contacts, made by `Problem.phases` or from a file.

    Args:
        name: in messages and files.
        sections: of the file.
        folder: in which the model's path is looked up.

    Example::

        empty = linkplan.Phase("empty", start_deg={"O": -20.0}, goal_deg={"O": 10.0})
        loaded = linkplan.Phase("loaded", payload="shank", goal_deg={"O": 30.0})
        lift = linkplan.Problem.phases("optimus-knee", [empty, loaded], motion={"duration_s": 0.4})
        print(lift.to_toml())
    """

    name: str
    sections: PhasedFile
    folder: Path | None = None

    def __post_init__(self) -> None:
        names = [phase.name for phase in self.phases]
        for name in names:
            if names.count(name) > 1:
                raise ProblemError(f"two phases have the name '{name}'")
        for name, contact in self.sections.contacts.items():
            if not contact.site:
                raise ProblemError(f"contacts.{name}.site needs at least one site, got none")
        for k in range(len(self.phases)):
            self._check_contacts(k)
            self._check_joint_values(k)
        self._check_whole()

    def _check_contacts(self, k: int) -> None:
        """Refuse unknown contacts of a phase, and a site that stands twice."""
        phase, standing = self.phases[k], dict[str, str]()
        for contact in (*phase.on, *phase.at):
            choose(f"contact of phases[{k}].on", contact, self.sections.contacts, ProblemError)
        for contact in phase.at:
            if contact not in phase.on:
                raise ProblemError(f"phases[{k}].at names contact {contact}, which is not in phases[{k}].on")
        for contact in phase.on:
            for site in self.sites_of(contact):
                if site in standing:
                    raise ProblemError(f"phases[{k}].on: site '{site}' stands twice, by {standing[site]} and by {contact}")
                standing[site] = contact

    def _check_joint_values(self, k: int) -> None:
        """Refuse a position at the end of a phase other than at the start of the next."""
        for unit in ("deg", "m") if k + 1 < len(self.phases) else ():
            end, start = getattr(self.phases[k], f"goal_{unit}"), getattr(self.phases[k + 1], f"start_{unit}")
            for joint in end.keys() & start.keys():
                if end[joint] != start[joint]:
                    raise ProblemError(
                        f"joint '{joint}' is at one place where phase {self.phases[k].name} ends and the next begins, got "
                        f"phases[{k}].goal_{unit} = {end[joint]:g} and phases[{k + 1}].start_{unit} = {start[joint]:g}"
                    )

    def _check_whole(self) -> None:
        """Refuse keys of the whole motion that exclude one another."""
        motion, objective = self.sections.motion, self.sections.objective
        for key, given in motion.to_dict().items():
            if key in ("mirror", "distance_m", "speed_m_s") and given not in (None, {}) and not motion.repeat:
                raise ProblemError(f"motion.{key} belongs to a gait: set motion.repeat = true")
        asked = objective.to_dict()
        if "minimize" in asked and "maximize" in asked:
            raise ProblemError("objective.minimize and objective.maximize are two objectives; keep one")
        if objective.maximize is not None and not any(asked["maximize"].values()):
            raise ProblemError("objective.maximize must have com_height, distance or both, got neither")
        known = [float(phase.duration_s) for phase in self.phases if phase.duration_s != "free"]
        if motion.duration_s != "free" and sum(known) > float(motion.duration_s):
            raise ProblemError(
                f"motion.duration_s must be at least the {sum(known):g} s of phases, got {motion.duration_s:g}"
            )

    @classmethod
    def from_file(cls, path: str | Path, settings: Mapping[str, object] | None = None) -> PhasedProblem:
        """Return the problem of a TOML file, with settings by dotted key.

        Raises:
            LinkplanError: if the file or the settings are invalid.
        """
        name, tables, folder = read_tables(path)
        apply_settings(tables, settings or {})
        return cls.from_tables(name, tables, folder)

    @classmethod
    def from_tables(cls, name: str, tables: Tables, folder: Path | None = None) -> PhasedProblem:
        """Return the problem of a file's tables."""
        return cls(name=checked_name(name), sections=read(PhasedFile, to_toml_types(tables), ""), folder=folder)

    @classmethod
    def of(
        cls, mechanism: Mechanism | str | Path, phases: Sequence[Phase | Mapping[str, Any]], tables: Mapping[str, Any]
    ) -> PhasedProblem:
        """Return the problem of a mechanism, its phases, and the other tables of a file.

        Raises:
            LinkplanError: if they are invalid.
        """
        table = table_of(mechanism) if isinstance(mechanism, Mechanism) else {"model": str(mechanism)}
        listed = [one.to_dict() if isinstance(one, Phase) else dict(one) for one in phases]
        given = {key: value for key, value in tables.items() if value is not None}
        name = given.pop("name", f"{mechanism.name if isinstance(mechanism, Mechanism) else 'motion'}-phases")
        return cls.from_tables(name, {"mechanism": table, "phases": listed} | to_toml_types(given))

    @property
    def phases(self) -> Sequence[Phase]:
        """The phases in order."""
        return self.sections.phases

    def to_dict(self) -> dict:
        """Return the problem as the tables of a file."""
        return self.sections.to_dict()

    def to_toml(self) -> str:
        """Return the problem as the text of a file."""
        return toml_text(self.to_dict())

    def replace(self, key: str, value: object) -> PhasedProblem:
        """Return the problem with a new value of a dotted key, checked as that of a file; None stands for the default."""
        tables = self.to_dict()
        apply_settings(tables, {key: value})
        return self.from_tables(self.name, tables, self.folder)

    def sites_of(self, contact: str) -> tuple[str, ...]:
        """Return the sites of a contact."""
        asked: ContactSection = self.sections.contacts[contact]
        return (asked.site,) if isinstance(asked.site, str) else tuple(asked.site)

    def mechanism_table(self, k: int, stand: Mapping[str, np.ndarray]) -> dict[str, Any]:
        """Return the table [mechanism] of a phase whose sites stand at points (3,) [m], with the ground's normal (3,)."""
        phase, table = self.phases[k], self.sections.mechanism.to_dict()
        if phase.open:
            table["open"] = [*table.get("open", []), *phase.open]
        if phase.payload is not None:
            table["payload"] = phase.to_dict()["payload"]
        if phase.payload_kg is not None:
            table["payload"] = self._payload(k, table.get("payload"), phase.payload_kg)
        if stand:
            places = {name: [float(x) for x in place] for name, place in stand.items()}
            table["stand"] = table.get("stand", {}) | places
        return table

    def _payload(self, k: int, payload: Any, mass_kg: float) -> dict[str, Any] | str:
        """Return the table of a payload with another mass; one without a place is carried by the last body.

        Raises:
            ProblemError: if there are several last bodies.
        """
        if mass_kg == 0:
            return "none"
        if isinstance(payload, Mapping):
            return dict(payload) | {"mass_kg": mass_kg}
        place = _last_body(self)
        if place is None:
            raise ProblemError(
                f"phases[{k}].payload_kg needs mechanism.payload = {{ body = ..., mass_kg = ..., com_m = [x, y, z] }}: the"
                " mechanism has no single last body that could carry it"
            )
        return place | {"mass_kg": mass_kg}

    def bare_mechanism(self, k: int) -> Mechanism:
        """Return the mechanism of a phase without its contacts."""
        table = self.mechanism_table(k, {})
        table.pop("independent", None)
        return self._loaded(table)

    def given(self, k: int, what: str, mechanism: Mechanism) -> dict[int, float]:
        """Return the positions or speeds [SI] by joint that a phase gives.

        `what` is start, goal, start_speed_s or goal_speed_s.
        """
        shown = joint_values(self.phases[k], what, f"phases[{k}]", mechanism)
        found = {index: mechanism.joints[index].read(value) for index, value in shown.items()}
        for index, value in found.items() if what in ("start", "goal") else ():
            joint = mechanism.joints[index]
            if not joint.lower <= value <= joint.upper:
                low, high = joint.text(joint.lower, 6), joint.text(joint.upper, 6)
                raise ProblemError(
                    f"phases[{k}].{what}_{joint.unit}.{joint.name} must be within the joint's range from {low} to {high} "
                    f"{joint.unit}, got {joint.text(value, 6)}"
                )
        return found

    def problem_tables(
        self,
        k: int,
        stand: Mapping[str, np.ndarray],
        ends: np.ndarray,
        mechanism: Mechanism,
        *,
        speeds: np.ndarray | None = None,
        walls: bool = True,
    ) -> Tables:
        """Return the tables of the problem of a phase between two closed poses (2, n_q) [rad or m], at rest by default.

        Args:
            k: the number of the phase.
            stand: the places of its standing sites.
            ends: the poses.
            mechanism: that of the phase.
            speeds: of the independent joints (2, n_s) at both ends.
            walls: whether contacts that do not stand stay above the ground.
        """
        phase, sections = self.phases[k], self.sections
        tables: Tables = {key: value for key, value in sections.to_dict().items() if key in _COMMON}
        tables["mechanism"] = self.mechanism_table(k, stand)
        motion = {key: value for key, value in phase.to_dict().items() if key in _MOTION}
        tables["motion"] = {"kind": "reach", **motion} | _boundary(mechanism, ends, speeds)
        objective = sections.objective.to_dict()
        # Where something else is maximised, these choose among equal motions: without a wait, or with little effort.
        tie = {"minimize": "effort" if self.ends_in_flight(k) or phase.duration_s != "free" else "time"}
        tables["objective"] = tie if "maximize" in objective else objective
        limits = sections.to_dict().get("limits", {}) | phase.to_dict().get("limits", {})
        friction = {
            site: np.inf if (share := sections.contacts[contact].friction) is None else share
            for contact in phase.on
            for site in self.sites_of(contact)
        }
        limits |= {"friction": limits.get("friction", {}) | friction} if friction else {}
        ground = self._walls(k, mechanism) if walls else {}
        tables["limits"] = limits | ({"site": _joined(limits.get("site", {}), ground)} if ground else {})
        return tables

    def mechanism(self, k: int, stand: Mapping[str, np.ndarray]) -> Mechanism:
        """Return the mechanism of a phase whose sites stand at places."""
        return self._loaded(self.mechanism_table(k, stand))

    def _loaded(self, table: Mapping[str, Any]) -> Mechanism:
        """Return the mechanism of a table [mechanism] with the parameters of the file."""
        parameters = self.sections.to_dict().get("parameters")
        tables = {"mechanism": dict(table)} | ({"parameters": parameters} if parameters else {})
        return mechanism_from_tables(tables, self.folder)

    def _walls(self, k: int, mechanism: Mechanism) -> dict[str, Any]:
        """Return the ground as walls for the sites of contacts that do not stand in a phase."""
        found = {}
        for name, contact in self.sections.contacts.items():
            ground = ground_of(mechanism.model, contact.plane)
            point = ground[:3] - _DEPTH_SHARE * mechanism.extent_m * ground[3:]
            for site in () if name in self.phases[k].on else self.sites_of(name):
                found[site] = {"normal": ground[3:].tolist(), "at": point.tolist()}
        return found

    def ends_in_flight(self, k: int) -> bool:
        """Whether a phase is a flight at the end of the motion whose end is given by nothing but its apex."""
        phase = self.phases[k]
        given = any(name.startswith("goal") for name in phase.to_dict())
        return k + 1 == len(self.phases) and not (phase.on or phase.rest or given) and phase.duration_s == "free"


@functools.lru_cache(maxsize=16)
def _last_body(asked: PhasedProblem) -> dict[str, Any] | None:
    """Return the only moving body without a moving child, and a place in it: its only site, else its centre of mass."""
    model = mechanism_from_tables({"mechanism": asked.sections.mechanism.to_dict()}, asked.folder).model
    moving = [body for body in range(1, model.nbody) if model.body_weldid[body]]
    last = [body for body in moving if body not in {int(model.body_parentid[other]) for other in moving}]
    if len(last) != 1 or not model.body(last[0]).name:
        return None
    sites = [site for site in range(model.nsite) if int(model.site_bodyid[site]) == last[0]]
    place = model.site_pos[sites[0]] if len(sites) == 1 else model.body_ipos[last[0]]
    return {"body": model.body(last[0]).name, "com_m": place.tolist()}


def _boundary(mechanism: Mechanism, ends: np.ndarray, speeds: np.ndarray | None) -> dict[str, Any]:
    """Return the keys of [motion] for two poses (2, n_q), and for the independent speeds (2, n_s) there."""
    found: dict[str, Any] = {}
    for end, (name, pose) in enumerate(zip(("start", "goal"), ends, strict=True)):
        for column, (index, joint) in enumerate(zip(mechanism.independent, mechanism.independent_joints, strict=True)):
            found.setdefault(f"{name}_{joint.unit}", {})[joint.name] = joint.shown(float(pose[index]))
            if speeds is not None:
                at = joint.shown(float(speeds[end, column]))
                found.setdefault(f"{name}_speed_{joint.unit}_s", {})[joint.name] = at
    return found


def _joined(sites: Mapping[str, Any], walls: Mapping[str, Any]) -> dict[str, Any]:
    """Return limits on sites with further walls."""
    found = dict(sites)
    for site, wall in walls.items():
        own = found.get(site, [])
        found[site] = [*(own if isinstance(own, list) else [own]), wall]
    return found


# The keys of a phase that its problem has in [motion].
_MOTION = ("duration_s", "min_duration_s", "max_duration_s", "waypoints")
