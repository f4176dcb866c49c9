"""The findings of `linkplan check` on contacts: contacts that make a plan false are problems, the others are notes."""

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.contacts import ContactPair, Meeting, exclusion, meetings
from linkplan.planner.certificate.collisions import geom_names
from linkplan.studies.check.kinematic_loop_report import KinematicLoopPath


def reach_sentence(pair: ContactPair, n_poses: int) -> str:
    """Return the sentence on geoms that collide somewhere within reach."""
    return (
        f"geoms {pair.first} and {pair.second} collide in {len(pair.poses)} of {n_poses} poses within reach, up to"
        f" {1e3 * pair.depth_m:.2g} mm deep"
    )


def contact_findings(
    mechanism: Mechanism, pairs: tuple[ContactPair, ...], n_poses: int, path: KinematicLoopPath | None, treatment: str
) -> tuple[list[str], list[str]]:
    """Return the problems and notes on contacts, each a sentence.

    Args:
        mechanism: with the geoms.
        pairs: geoms that collide at some of the poses within reach.
        n_poses: the number of checked poses within reach.
        path: a problem's motion; if None, the mechanism alone is checked and every contact is a problem.
        treatment: the problem's `contacts`, "refuse" or "note".
    """
    if path is None:
        return [
            f"{reach_sentence(pair, n_poses)}: contact forces are not planned for; where the links pass side by side,"
            f" {exclusion(pair.bodies)} in the model's <contact> says so"
            for pair in pairs
        ], []
    way = np.arange(float(len(path.poses)))

    def position_at(at: np.ndarray) -> np.ndarray:
        return np.array([np.interp(at, way, column) for column in path.positions.T]).T

    problems, notes, named = [], [], set()
    for meeting in meetings(mechanism, way, path.poses, position_at):
        named.add((meeting.first, meeting.second))
        if meeting.since is None:
            depth = f"up to {1e3 * meeting.depth_m:.2g} mm deep"
            notes.append(
                f"{geom_names(meeting)} overlap as deep at home, or on a pin that they share, {depth}: contact forces are"
                f" not planned for; the simulator applies them unless told {exclusion(meeting.bodies)}"
            )
        elif treatment == "note":
            notes.append(f"{_on_the_way(mechanism, meeting, path, position_at)}: contact forces are not planned for")
        else:
            said = _on_the_way(mechanism, meeting, path, position_at)
            problems.append(f'{said}: a plan through it is refused unless limits.contacts = "note"')
    for pair in pairs:
        if (pair.first, pair.second) not in named:
            notes.append(f"{reach_sentence(pair, n_poses)}, but not along {path.title}")
    return problems, notes


def _on_the_way(mechanism: Mechanism, meeting: Meeting, path: KinematicLoopPath, position_at) -> str:
    at = position_at(np.array([meeting.since]))[0]
    where = ", ".join(f"{j.name} = {j.said(x, 5)} {j.unit}" for j, x in zip(mechanism.independent_joints, at, strict=True))
    depth = f"up to {1e3 * meeting.depth_m:.2g} mm deep"
    return f"{geom_names(meeting)} collide at {where} on {path.title}, {depth}"
