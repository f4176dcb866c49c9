"""The poses between the phases of a motion, and the places on which its contacts stand: guesses for their search.

Each pose is the nearest one to a reference in which the closures of both phases hold, the contacts of both are on the
ground, and the given joints have their values. The place of the first contact, and of contacts whose base cannot slide
along the ground, follows from it. Other places are unknowns of the search, in which every phase has its own origin.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from linkplan.models.errors import ProblemError, choose
from linkplan.models.ground import ground_of
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.whole_body import centre_of_mass, fall_acceleration, ground_slides
from linkplan.models.tree.joints import unit_steps
from linkplan.planner.problem.phases import PhasedProblem

# A pose is closed, and stands, within this share of the mechanism's extent.
_CLOSED_SHARE = 1e-9
# Newton's steps to the rows, from a pose that almost has them.
_MOST_STEPS = 5
# Before a release a leg has pushed its body away: the first guess of such a pose raises it by this share of the extent.
_RISE_SHARE = 0.3


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PhasePoses:
    """Guessed poses (n_phases + 1, n_q) at the starts of all phases and at the end, and the ground under each phase.

    `stand` has the place of each standing site, the point and the normal (6,), of each phase. `slides` are the coordinates
    along which the origin of the next phase is free, for each junction, the last for that of a gait. `bare` are the
    mechanisms of the phases without contacts.
    """

    poses: np.ndarray
    stand: tuple[dict[str, np.ndarray], ...]
    slides: tuple[tuple[int, ...], ...]
    bare: tuple[Mechanism, ...]


def phase_poses(asked: PhasedProblem, extended: bool = True) -> PhasePoses:
    """Return the guessed poses of a motion in phases.

    Args:
        asked: the motion.
        extended: whether poses at a release, which nothing else determines, have a raised body.

    Raises:
        ProblemError: if there is no pose with the contacts and joints of an instant, with its phases.
    """
    n = len(asked.phases)
    bare = _bare(asked)
    slides = ground_slides(bare[0])
    for key in ("distance_m", "speed_m_s") if not slides else ():
        if getattr(asked.sections.motion, key) is not None:
            raise ProblemError(f"motion.{key} needs a base that slides along the ground; mechanism {bare[0].name} has none")
    maximize = asked.sections.objective.maximize
    if maximize is not None and maximize.com_height == "apex" and not fall_acceleration(bare[0]):
        raise ProblemError(f"objective.maximize.com_height = 'apex' needs gravity down; mechanism {bare[0].name} has none")
    ground = {name: ground_of(bare[0].model, one.plane) for name, one in asked.sections.contacts.items()}
    finder = _Finder(asked, bare, ground)
    sliding = [_slides(asked, k, slides) for k in range(n)]
    home = bare[0].home
    known = _given_places(asked, 0, finder, home)
    poses: list[np.ndarray] = [finder.pose(0, home, known, extended=False)]
    stand: list[dict[str, np.ndarray]] = []
    aim = poses[0]
    if asked.sections.motion.repeat:
        aim = poses[0][mirror_of(asked, bare[0])]
        if asked.sections.motion.distance_m is not None:
            aim[slides[0]] = poses[0][slides[0]] + asked.sections.motion.distance_m
    for k in range(n):
        own = {}
        for contact in asked.phases[k].on:
            stays = k > 0 and contact in asked.phases[k - 1].on
            anywhere = contact not in asked.phases[k].at and not stays and (k == 0 or bool(sliding[k - 1]))
            for site in asked.sites_of(contact):
                if site not in known or anywhere:
                    known[site] = finder.place(site, poses[k])
                own[site] = np.concatenate([known[site], ground[contact][3:]])
        stand.append(own)
        if k + 1 < n:
            known |= _given_places(asked, k + 1, finder, poses[k])
        reference = poses[k] + (aim - poses[k]) / (n - k)
        poses.append(finder.pose(k + 1, reference, _fixed(asked, k + 1, known, sliding), extended=extended))
    return PhasePoses(poses=np.array(poses), stand=tuple(stand), slides=tuple(sliding), bare=bare)


def _given_places(asked: PhasedProblem, k: int, finder: "_Finder", pose: np.ndarray) -> dict[str, np.ndarray]:
    """Return the places (3,) [m] of sites that phase k gives; those of a foot lie as in a pose (n_q,)."""
    found = {}
    for contact, place in asked.phases[k].at.items():
        first, *_ = sites = asked.sites_of(contact)
        for site in sites:
            found[site] = np.asarray(place, dtype=float) + finder.place(site, pose) - finder.place(first, pose)
    return found


def _bare(asked: PhasedProblem) -> tuple[Mechanism, ...]:
    """Return the mechanisms of the phases without contacts; equal ones are loaded once."""
    loaded: dict[str, Mechanism] = {}
    found = []
    for k in range(len(asked.phases)):
        key = repr(asked.mechanism_table(k, {}))
        if key not in loaded:
            loaded[key] = asked.bare_mechanism(k)
        found.append(loaded[key])
    names = [[joint.name for joint in mechanism.joints] for mechanism in found]
    if any(of != names[0] for of in names):
        raise ProblemError("the phases have different joints; payloads and closures may differ, joints may not")
    return tuple(found)


def _slides(asked: PhasedProblem, k: int, slides: tuple[int, ...]) -> tuple[int, ...]:
    """Return the coordinates along which the origin of the phase after phase k is free."""
    phases, repeat = asked.phases, asked.sections.motion.repeat
    if k + 1 == len(phases):
        return slides if repeat else ()
    after = phases[k + 1]
    stays = set(after.on) & set(phases[k].on)
    return slides if after.on and not stays and not after.at else ()


def _fixed(asked: PhasedProblem, k: int, known: Mapping[str, np.ndarray], sliding: Sequence[Sequence[int]]) -> dict:
    """Return the known places of sites that a pose at the start of phase k must have."""
    before = asked.phases[k - 1]
    sites = [site for contact in before.on for site in asked.sites_of(contact)]
    if k < len(asked.phases):
        after = asked.phases[k]
        touching = [contact for contact in after.on if contact not in before.on]
        sites += [site for contact in touching if not sliding[k - 1] for site in asked.sites_of(contact)]
    return {site: known[site] for site in sites if site in known}


def mirror_of(asked: PhasedProblem, mechanism: Mechanism) -> np.ndarray:
    """Return the exchange of coordinates with every repetition: coordinate i becomes coordinate order[i], (n_q,).

    Raises:
        ProblemError: for a joint that exchanges with two others, or with one of another kind.
    """
    order = np.arange(mechanism.n_q)
    for one, other in asked.sections.motion.mirror.items():
        i, j = (mechanism.joint_index(name, ProblemError) for name in (one, other))
        if {int(order[i]), int(order[j])} not in ({i}, {j}, {i, j}):
            raise ProblemError(f"motion.mirror: joint {one} or {other} exchanges with two joints")
        if mechanism.joints[i].kind != mechanism.joints[j].kind:
            raise ProblemError(f"motion.mirror: joints {one} and {other} are of two kinds")
        order[i], order[j] = j, i
    return order


def _releases(asked: PhasedProblem, k: int) -> bool:
    """Return whether contacts leave the ground at the start of phase k, or at the end of a jump without a flight."""
    maximize = asked.sections.objective.maximize
    if k == len(asked.phases):
        return bool(asked.phases[-1].on) and maximize is not None and maximize.com_height == "apex"
    return k > 0 and bool(set(asked.phases[k - 1].on) - set(asked.phases[k].on))


class _Finder:
    """Finds poses at the junctions of phases, with as few changes from a reference as possible."""

    def __init__(self, asked: PhasedProblem, bare: tuple[Mechanism, ...], ground: Mapping[str, np.ndarray]) -> None:
        self._asked, self._bare, self._ground = asked, bare, ground
        self._first = bare[0]
        self._sites = {self._first.model.site(s).name: s for s in range(self._first.model.nsite)}
        for contact in asked.sections.contacts:
            for site in asked.sites_of(contact):
                choose(f"site in contacts.{contact}.site", site, [name for name in self._sites if name], ProblemError)
        self._unit = unit_steps(self._first.joints, self._first.extent_m)

    def place(self, site: str, q: np.ndarray) -> np.ndarray:
        """Return the place (3,) [m] of a site."""
        return np.array(self._first.dynamics.site_places(q))[:, self._sites[site]]

    def pose(self, k: int, reference: np.ndarray, fixed: Mapping[str, np.ndarray], *, extended: bool) -> np.ndarray:
        """Return the pose (n_q,) at the start of phase k, or at the end, nearest to a reference.

        Raises:
            ProblemError: if there is none.
        """
        asked = self._asked
        sides = [i for i in (k - 1, k) if 0 <= i < len(asked.phases)]
        given: dict[int, float] = {}
        for i in sides:
            given |= asked.given(i, "start" if i == k else "goal", self._bare[i])
        on = dict.fromkeys(contact for i in sides for contact in asked.phases[i].on)
        q, start = ca.SX.sym("q", self._first.n_q), np.array(reference)
        start[list(given)] = list(given.values())
        free = np.setdiff1d(np.arange(self._first.n_q), list(given)).astype(int)
        hard = self._rows(q, sides, on, fixed)
        wish = self._wishes(q, start, free, raised=extended and _releases(asked, k))
        found = self._nearest(q, hard, wish, start, free) if len(free) else start
        gap = np.abs(np.array(ca.Function("gap", [q], [ca.densify(hard)])(found))).max(initial=0.0)
        if gap > _CLOSED_SHARE:
            raise ProblemError(self._nowhere(k, sides, on, gap * self._first.extent_m))
        return found

    def _rows(self, q: ca.SX, sides: Sequence[int], on: Iterable[str], fixed: Mapping[str, np.ndarray]) -> ca.SX:
        """Return what is zero at a pose, in extents: the closures of phases, and the heights or places of standing sites."""
        rows, places = [self._bare[i].dynamics.closure(q) for i in sides], self._first.dynamics.site_places(q)
        for contact in on:
            point, normal = ca.DM(self._ground[contact][:3]), ca.DM(self._ground[contact][3:])
            for site in self._asked.sites_of(contact):
                at = places[:, self._sites[site]]
                rows += [ca.dot(normal, at - point)] + ([at - ca.DM(fixed[site])] if site in fixed else [])
        return ca.vertcat(ca.SX(0, 1), *rows) / self._first.extent_m

    def _wishes(self, q: ca.SX, start: np.ndarray, free: np.ndarray, *, raised: bool) -> ca.SX:
        """Return what should be small at a pose: changes of free coordinates, and the height that a raised body lacks."""
        wish = 1e-3 * ((q - ca.DM(start)) / ca.DM(self._unit))[free.tolist()]
        if not raised:
            return wish
        height = centre_of_mass(self._first)
        lacks = float(height(start)[2]) / self._first.extent_m + _RISE_SHARE - height(q)[2] / self._first.extent_m
        return ca.vertcat(wish, 1e-2 * lacks)

    def _nearest(self, q: ca.SX, hard: ca.SX, wish: ca.SX, start: np.ndarray, free: np.ndarray) -> np.ndarray:
        """Return the pose (n_q,) within the ranges with the least rows and wishes; Newton's steps end on the rows."""
        import scipy

        def with_slope(rows: ca.SX) -> Callable[[np.ndarray], list[np.ndarray]]:
            function = ca.Function("rows", [q], [ca.densify(rows), ca.densify(ca.jacobian(rows, q)[:, free.tolist()])])

            def at(x: np.ndarray) -> list[np.ndarray]:
                whole = np.array(start)
                whole[free] = x
                return [np.array(part) for part in function(whole)]

            return at

        both, exact, unit = with_slope(ca.vertcat(hard, wish)), with_slope(hard), self._unit[free]
        low, high = np.array([(joint.lower, joint.upper) for joint in self._first.joints])[free].T
        low, high = low - 1e-9 * unit, high + 1e-9 * unit
        result = scipy.optimize.least_squares(
            lambda x: both(x)[0].ravel(),
            np.clip(start[free], low, high),
            jac=lambda x: both(x)[1],
            bounds=(low, high),
            x_scale=unit,
        )
        x = result.x
        for _ in range(_MOST_STEPS if hard.numel() else 0):
            value, slope = exact(x)
            x = x + unit * np.linalg.lstsq(slope * unit, -value.ravel(), rcond=1e-10)[0]
        found = np.array(start)
        found[free] = x
        return found

    def _nowhere(self, k: int, sides: Sequence[int], on: Iterable[str], gap_m: float) -> str:
        """Return a sentence on an instant without a pose."""
        names = " and ".join(self._asked.phases[i].name for i in sides)
        where = "at the start of" if k == 0 else "at the end of" if k == len(self._asked.phases) else "between"
        what = f"with {', '.join(on)} on the ground and the given joints" if on else "with the given joints"
        return f"{where} phases {names} there is no pose {what}; the nearest one misses it by {gap_m:.3g} m"
