"""The links of all phases in one program, junctions, repetition, given values and what is maximised, and the weights."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np

from linkplan.models.poses.whole_body import centre_of_mass, centre_velocity, fall_acceleration, unit_acceleration
from linkplan.planner.closed_chain.junction import Side, end_link, junction
from linkplan.planner.limits.kinds import effort_bounds
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.phase_set import PhaseSet
from linkplan.planner.transcription.collocation import Transcribed
from linkplan.planner.transcription.linked import Link


def links_of(of: PhaseSet, parts: Sequence[Transcribed], own: Sequence[np.ndarray] | None) -> list[Link]:
    """Return the links between the programs of the phases; `own` are their unknowns to start from, by default guesses.

    The first are those of the junctions, that of a gait included.
    """
    n, motion = len(parts), of.asked.sections.motion
    sides = [
        Side(program=k, mechanism=phase.mechanism, scales=part.origin.scales)
        for k, (phase, part) in enumerate(zip(of.phases, parts, strict=True))
    ]
    links = [
        junction(before, after, of.exchange(k), of.inertia(k, k + 1), n, of.at.poses[k + 1])
        for k, (before, after) in enumerate(pairwise(sides))
    ]
    if motion.repeat:
        gait = junction(sides[-1], sides[0], of.exchange(n - 1), of.inertia(n - 1, 0), n, of.at.poses[n])
        links.append(_stride(of, gait, sides))
    if motion.duration_s != "free":
        links.append(_whole_duration(float(motion.duration_s), sides))
    links += _given_links(of, sides)
    if of.asked.sections.objective.maximize is not None:
        links.append(end_link(sides[-1], n, of.at.poses[n], further=lambda q, rates: _maximised(of, q, rates)))
    return links if own is None else [replace(link, own=values) for link, values in zip(links, own, strict=True)]


def weights_of(of: PhaseSet, parts: Sequence[Transcribed], tie: float) -> tuple[np.ndarray, float]:
    """Return the factors (n,) on the phases' scaled objectives, and the unit of the whole objective [SI].

    Where something else is maximised, `tie` is the weight of time, in units of a fall, and of squared efforts, in units of
    those at all limits during a fall.
    """
    if of.asked.sections.objective.maximize is not None:
        unit = of.first.extent_m
        fall = float(np.sqrt(unit / unit_acceleration(of.first)))
        sizes = [
            part.objective_scale / _size_of_tie(phase.problem, fall) for phase, part in zip(of.phases, parts, strict=True)
        ]
        return tie * np.array(sizes), unit
    shares = np.array([phase.weight for phase in of.asked.phases])
    values = shares * np.array([part.objective_scale for part in parts])
    return values / values.max(), float(values.max())


def _size_of_tie(problem: Problem, fall_s: float) -> float:
    """Return the unit [SI] of a phase's own objective where something else is maximised."""
    if problem.objective.has("time"):
        return fall_s
    largest = np.abs(effort_bounds(problem)).max(axis=1)
    squares = float(np.sum(largest[np.isfinite(largest)] ** 2))
    return (squares or 1.0) * fall_s


def _stride(of: PhaseSet, gait: Link, sides: Sequence[Side]) -> Link:
    """Return the link of a gait with its distance or speed."""
    motion, slides = of.asked.sections.motion, of.at.slides[-1]
    if not slides:
        return gait
    extent, first = of.first.extent_m, of.first.n_q  # its own unknown after those of the pose
    own, bounds = gait.own.copy(), gait.bounds.copy()
    if motion.distance_m is not None:
        own[first] = bounds[first] = motion.distance_m / extent
    if motion.speed_m_s is None:
        return replace(gait, own=own, bounds=bounds)
    states, durations, unknowns = (ca.SX.sym(name, gait.function.numel_in(i)) for i, name in enumerate("sdo"))
    rows, cost = gait.function(states, durations, unknowns)
    total = sum(durations[k] * side.scales.time_s for k, side in enumerate(sides))
    rows = ca.vertcat(rows, unknowns[first] - motion.speed_m_s * total / extent)
    function = ca.Function("gait", [states, durations, unknowns], [rows, cost])
    return replace(gait, own=own, bounds=bounds, function=function)


def _whole_duration(duration_s: float, sides: Sequence[Side]) -> Link:
    """Return the link that the phases take a given time together."""
    states, durations, own = (ca.SX.sym(name, size) for name, size in (("s", 0), ("d", len(sides)), ("o", 0)))
    total = sum(durations[k] * side.scales.time_s for k, side in enumerate(sides))
    function = ca.Function("duration", [states, durations, own], [total / duration_s - 1.0, ca.SX(0)])
    return Link(ends=(), function=function)


def _given_links(of: PhaseSet, sides: Sequence[Side]) -> Iterator[Link]:
    """Yield links for given positions and speeds of dependent joints; at the end of a motion they rest by default."""
    asked, n = of.asked, len(sides)
    repeat = asked.sections.motion.repeat
    for k, side in enumerate(sides):
        mechanism = side.mechanism
        dependent = mechanism.dependent.tolist()
        for end, name in enumerate(("start", "goal")):
            if end == 0 and k == 0 and not repeat:
                continue  # the whole pose is given
            at = {i: x for i, x in asked.given(k, name, mechanism).items() if i in dependent}
            moving = {i: x for i, x in asked.given(k, f"{name}_speed_s", mechanism).items() if i in dependent}
            if end == 1 and k + 1 == n and not repeat:
                open_speeds = int(np.sum(of.phases[k].case.free_ends[1, mechanism.dof :]))
                moving = dict.fromkeys(list(at)[:open_speeds], 0.0) | moving
            if at or moving:
                yield end_link(side, n, of.at.poses[k + end], end=-end, positions=at, speeds=moving)


def _maximised(of: PhaseSet, q: ca.SX, rates: ca.SX) -> tuple[ca.SX, list[ca.SX]]:
    """Return the scaled quantity to minimise at the end, the negative height or distance, and rows that are zero there.

    A flight whose end nothing else determines ends at its apex.
    """
    mechanism, asked = of.phases[-1].mechanism, of.asked.sections.objective.maximize
    assert asked is not None  # the caller ensures it
    place, up = centre_of_mass(mechanism)(q), centre_velocity(mechanism)(q, rates)[2]
    cost, unit, gravity = ca.SX(0), of.first.extent_m, fall_acceleration(mechanism)
    if asked.com_height is not None:
        cost -= place[2] / unit
    if asked.distance is not None:
        cost -= place[0] / unit
    if asked.com_height != "apex":
        return cost, []
    if of.asked.ends_in_flight(len(of.phases) - 1):
        return cost, [up / np.sqrt(gravity * unit)]
    return cost - up * up / (2.0 * gravity * unit), []
