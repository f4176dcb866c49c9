"""The findings of `linkplan check` on contacts. Contacts that invalidate a plan are problems, the others are notes."""

from collections.abc import Sequence

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.contacts import Contact, ContactPair, exclusion, meetings
from linkplan.models.tree.joints import where
from linkplan.planner.certificate.further_checks import contact_notes, geom_names
from linkplan.studies.check.kinematic_loop_report import KinematicLoopPath


def reach_sentence(pair: ContactPair, n_poses: int) -> str:
    """Return the sentence on geoms that collide somewhere within reach."""
    return (
        f"geoms {' and '.join(pair.geoms)} collide in {len(pair.poses)} of {n_poses} poses within reach, up to"
        f" {1e3 * pair.depth_m:.2g} mm deep"
    )


def contact_findings(
    mechanism: Mechanism,
    pairs: tuple[ContactPair, ...],
    sweeps: Sequence[int],
    path: KinematicLoopPath | None,
    treatment: str,
) -> tuple[list[str], list[str]]:
    """Return the problems and notes on contacts, each a sentence.

    Args:
        mechanism: with the geoms.
        pairs: geoms that collide at some of the poses within reach.
        sweeps: the number of checked poses within the reach of each coordinate.
        path: a problem's motion; if None, the mechanism alone is checked and every contact is a problem.
        treatment: the problem's `contacts`, "refuse" or "note".
    """
    n_poses = sum(sweeps)
    if path is None:
        pads = [pair for pair in pairs if _meet_at_an_end(pair, sweeps)]
        return [
            f"{reach_sentence(pair, n_poses)}: contact forces are not planned for; {exclusion(pair.bodies)} in the model's"
            " <contact> lets links pass side by side"
            for pair in pairs
            if pair not in pads
        ], [
            f"geoms {' and '.join(pair.geoms)} touch near an end of the reach, like a gripper's pads or a stop, up to"
            f" {1e3 * pair.depth_m:.2g} mm deep: keep motions away from this end"
            for pair in pads
        ]
    way = np.arange(float(len(path.poses)))

    def position_at(at: np.ndarray) -> np.ndarray:
        return np.array([np.interp(at, way, column) for column in path.positions.T]).T

    problems, notes, named = [], [], set()
    found = meetings(mechanism, way, path.poses, position_at)
    notes.extend(contact_notes(tuple(meeting for meeting in found if meeting.since_s is None)))
    for meeting in found:
        named.add(meeting.geoms)
        if meeting.since_s is None:
            continue
        said = _on_the_way(mechanism, meeting, path, position_at)
        if treatment == "note":
            notes.append(f"{said}: plans have no contact forces")
        else:
            problems.append(f'{said}: a plan through it is refused unless limits.contacts = "note"')
    for pair in pairs:
        if pair.geoms not in named:
            notes.append(f"{reach_sentence(pair, n_poses)}, but not along {path.title}")
    return problems, notes


def _meet_at_an_end(pair: ContactPair, sweeps: Sequence[int]) -> bool:
    """Tell if two links touch only near one end of reaches."""
    meets = np.zeros(sum(sweeps), dtype=bool)
    meets[list(pair.poses)] = True
    for of_one in np.split(meets, np.cumsum(sweeps)[:-1]):
        changes = np.count_nonzero(np.diff(of_one.astype(int)))
        if of_one.any() and changes != 1:
            return False
    return not pair.on_ground


def _on_the_way(mechanism: Mechanism, meeting: Contact, path: KinematicLoopPath, position_at) -> str:
    at = position_at(np.array([meeting.since_s]))[0]
    place, depth = where(mechanism.independent_joints, at, 5), f"up to {1e3 * meeting.depth_m:.2g} mm deep"
    return f"{geom_names(meeting)} collide at {place} on {path.title}, {depth}"
