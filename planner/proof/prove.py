"""The proof of a motion. Boxes of time are halved until each claim is decided, or the box is too short to halve."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from flint import arb, arb_poly, arb_series, ctx

from linkplan.models.deadline import NO_DEADLINE, Deadline, OutOfTimeError
from linkplan.planner.problem.problem import Problem
from linkplan.planner.proof.branch import EnclosedRoot, krawczyk, newton, series_of
from linkplan.planner.proof.claims import Claim, Record, claims_of, finding_of_claim, sampled_findings, undecided_reason
from linkplan.planner.proof.ends import START_POSE_ERROR, end_findings, position_spans
from linkplan.planner.proof.existence import (
    EXISTENCE_SECONDS,
    Neighbourhood,
    first_tube,
)
from linkplan.planner.proof.finding import Finding, Proof, no_motion
from linkplan.planner.proof.motion import Piece, State
from linkplan.planner.proof.taylor import NotSeparatedError, TaylorForm
from linkplan.planner.proof.walk import Blocks, UnknownOperationError, blocks_of
from linkplan.planner.trajectory import JOIN_SHARE, Trajectory

# Bits of the balls' midpoints: 27 more than the coefficients have.
_PRECISION_BITS = 80
# The number of coefficients of a Taylor form before its remainder: for claims, and for the search for a motion of the model
# near the plan. More coefficients permit larger boxes. Claims on ten plans of several motors take 0.6 to 1 of the time that
# they take with 6, those on three plans of one motor 0.95 to 1.05. The search keeps 6, because larger boxes widen its tube:
# with 8, it finds no motion near the squeezer's plan.
TAYLOR_ORDER, _ORDER_NEAR_PLAN = 8, 6
# Halvings of an interval of the mesh after which a claim is undecided, and boxes in all for each of its intervals.
_MAX_HALVINGS, _MAX_BOXES_PER_INTERVAL = 32, 200
# Stands among a box's claims for the existence of a motion near the plan.
_NEAR_PLAN = -1
# After so many boxes without a closed branch none is halved any more: the loops do not close.
_MAX_LOST = 16
# A bound beyond the known range whose remainder is large is not used until so many halvings.
_TIGHTENING_ROUNDS = 8


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Box:
    """tau in [centre - radius, centre + radius] of an interval, after a number of halvings, and its open claims."""

    centre: float
    radius: float
    halvings: int
    claims: list[int]

    def halves(self, claims: list[int]) -> list["_Box"]:
        r = self.radius / 2
        return [_Box(centre=self.centre + side * r, radius=r, halvings=self.halvings + 1, claims=claims) for side in (1, -1)]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Anchor:
    """The branch up to a time: the region in which its root is unique (None if the branch was lost), and the root there.

    `z` and `slope` = dz/dtau are floating-point numbers.
    """

    region: list[arb] | None
    end: list[arb]
    z: np.ndarray
    slope: np.ndarray  # dz/dtau
    tau: float


def prove(
    problem: Problem,
    trajectory: Trajectory,
    failures: Sequence[str] = (),
    until: Deadline = NO_DEADLINE,
    *,
    existence: bool = True,
) -> Proof:
    """Return the proof of the claims on a trajectory, from the coefficients of its polynomials.

    Args:
        problem: the problem with its limits.
        trajectory: the motion.
        failures: sentences of the certificate on limits that samples violate.
        until: the deadline. When it passes, the search for a motion of the model ends.
        existence: whether to search for a motion of the model near the trajectory.

    Raises:
        OutOfTimeError: if the deadline passes before all claims are decided, or is predicted to do so.
    """
    begun, before = time.process_time(), (ctx.prec, ctx.cap)
    ctx.prec = _PRECISION_BITS
    try:
        found, boxes = _along(problem, trajectory, until)
        of_claims = time.process_time()
        if existence and any(finding.answer == "refuted" for finding in found):
            found.append(no_motion("a limit is refuted"))
        else:
            found += _existence(problem, trajectory, until.within(EXISTENCE_SECONDS), existence=existence)
    finally:
        ctx.prec, ctx.cap = before
    findings = (*end_findings(problem, trajectory), *found, *sampled_findings(problem, failures))
    took = {"seconds": of_claims - begun, "existence_seconds": time.process_time() - of_claims}
    return Proof(findings=findings, boxes=boxes, **took)


def _along(problem: Problem, trajectory: Trajectory, until: Deadline) -> tuple[list[Finding], int]:
    """Return the findings on the claims at every instant, and the number of boxes."""
    try:
        blocks, (claims, open_limits) = blocks_of(problem.mechanism), claims_of(problem, trajectory)
        sweep = _Sweep(problem=problem, trajectory=trajectory, blocks=blocks, claims=claims, until=until, order=TAYLOR_ORDER)
        sweep.run()
    except UnknownOperationError as error:
        reason = f"not proved: the model has an operation that balls do not enclose ({error})"
        return [Finding(name="closure and efforts", answer="undecided", reason=reason)], 0
    return [*sweep.findings(), *open_limits], sweep.boxes


def _existence(problem: Problem, trajectory: Trajectory, until: Deadline, *, existence: bool) -> list[Finding]:
    """Return the findings on a motion of the model near a trajectory whose loops are proved to close."""
    if not existence:
        return [no_motion("`linkplan prove` looks for one")]
    found, tube = [no_motion("there is no time left")], first_tube(trajectory)
    while tube is not None and not until.passed and any(finding.answer != "proved" for finding in found):
        try:
            blocks, near = blocks_of(problem.mechanism), Neighbourhood(problem.mechanism, trajectory, tube)
        except UnknownOperationError as error:
            return [no_motion(f"the model has an operation that balls do not enclose ({error})")]
        sweep = _Sweep(
            problem=problem, trajectory=trajectory, blocks=blocks, claims=[], until=until, order=_ORDER_NEAR_PLAN, near=near
        )
        sweep.run()
        found = near.findings() if near.failure or not sweep.closure.undecided else [no_motion("the branch is lost")]
        tube = near.next_tube
    return found


@dataclass(eq=False, kw_only=True)
class _Sweep:
    """One pass over the boxes of a motion, in the order of time."""

    problem: Problem
    trajectory: Trajectory
    blocks: Blocks
    claims: list[Claim]
    until: Deadline
    order: int
    boxes: int = 0
    records: list[Record] = field(default_factory=list)
    closure: Record = field(default_factory=Record)
    start_gap: float = 0.0
    near: Neighbourhood | None = None
    depth: int = 0  # halvings of the next interval's first boxes
    interval: int = 0

    def run(self) -> None:
        trajectory, n = self.trajectory, len(self.trajectory.breaks_s) - 1
        self.records = [Record() for _ in self.claims]
        self.marks = [tuple(map(arb, claim.marks)) for claim in self.claims]
        self.slack = [arb(0, float(JOIN_SHARE * x)) for x in position_spans(self.problem, trajectory)]
        begun_s, anchor = self.until.left_s, None
        for k in range(n):
            left_s = self.until.left_s
            if self.near and self.near.failure:
                return
            if k and not self.near and (begun_s - left_s) * (n - k) > k * left_s:
                raise OutOfTimeError(f"{k} of {n} intervals show that the proof takes longer than the time that it has")
            piece = Piece.of(trajectory, k)
            anchor = self._start(piece) if anchor is None else anchor
            anchor = self._interval(piece, replace(anchor, slope=0 * anchor.slope, tau=0.0))

    def _start(self, piece: Piece) -> _Anchor:
        """Return the branch of the start pose, and record the distance of this pose from the closed pose."""
        given = self.trajectory.start_pose[list(self.blocks.dependent)]
        s = [p(arb(0)) for p in piece.position]
        try:
            root = krawczyk(
                self.blocks, s, newton(self.blocks, self.trajectory.start_pose[list(self.blocks.independent)], given)
            )
        except NotSeparatedError:
            self.closure.undecided.append((piece.begin_s, piece.begin_s))
            return _Anchor(region=None, end=[], z=given, slope=np.zeros_like(given), tau=0.0)
        pairs = zip(root.enclosure, given.tolist(), strict=True)
        self.start_gap = max((float(abs(x - g).upper()) for x, g in pairs), default=0.0)
        z = np.array([float(x.mid()) for x in root.enclosure])
        return _Anchor(region=root.region, end=root.enclosure, z=z, slope=np.zeros_like(z), tau=0.0)

    def _lost(self, piece: Piece, box: _Box, anchor: _Anchor) -> _Anchor:
        """Return the anchor from which the sweep continues after a box without a branch: a guess by Newton's method."""
        tau = box.centre + box.radius
        z = anchor.z + (tau - anchor.tau) * anchor.slope
        try:
            z = newton(self.blocks, np.array([float(p(arb(tau)).mid()) for p in piece.position]), z)
        except NotSeparatedError:
            z = anchor.z
        return _Anchor(region=None, end=[], z=z, slope=0 * z, tau=tau)

    def _interval(self, piece: Piece, anchor: _Anchor) -> _Anchor:
        """Decide the claims on one interval, and return the branch at its end."""
        asked = [_NEAR_PLAN] if self.near else list(range(len(self.claims)))
        stack = _boxes(self.depth, asked)
        coarsest = _MAX_HALVINGS
        most = _MAX_BOXES_PER_INTERVAL * max(20, len(self.trajectory.breaks_s) - 1)
        while stack:
            box = stack.pop()
            open_claims = [i for i in box.claims if i == _NEAR_PLAN or self.records[i].refuted is None]
            if self.until.passed:
                if not self.near:
                    raise OutOfTimeError("the time for the proof is over")
                self._leave(piece, box, open_claims, closed=False)
                continue
            lost = len(self.closure.undecided) >= _MAX_LOST
            last = lost or box.halvings == _MAX_HALVINGS or self.boxes >= most
            self.boxes += 1
            self.closure.boxes += 1
            try:
                states, anchor = self._states(piece, box, anchor)
            except (NotSeparatedError, ZeroDivisionError, ValueError):
                if last:
                    self._leave(piece, box, open_claims, closed=False)
                    anchor = self._lost(piece, box, anchor)
                else:
                    stack += box.halves(open_claims)
                continue
            left = [i for i in open_claims if not self._decided(i, states, piece, box)]
            coarsest = coarsest if left else min(coarsest, box.halvings)
            if left and last:
                self._leave(piece, box, left, closed=True)
            elif left:
                stack += box.halves(left)
        self.interval += 1
        if coarsest < _MAX_HALVINGS:
            self.depth = max(0, coarsest - (self.interval % 4 == 0))  # sometimes coarser boxes are tried
        return anchor

    def _states(self, piece: Piece, box: _Box, anchor: _Anchor) -> tuple[tuple[State, State], _Anchor]:
        """Return the states at the middle of a box and over the box, and the branch at its end.

        Raises:
            NotSeparatedError: if the branch cannot be enclosed, or is not proved to be that of the anchor.
        """
        blocks = self.blocks
        guess = anchor.z + (box.centre - anchor.tau) * anchor.slope
        s = np.array([float(p(arb(box.centre)).mid()) for p in piece.position])
        z = newton(blocks, s, guess)
        middle, whole, root = states_of(blocks, piece, (box.centre, box.radius), z, self.slack, self.order)
        forms = [TaylorForm.of(a, b, self.order) for a, b in zip(middle.z, whole.z, strict=True)]
        begin = [form.at_start() for form in forms]
        if anchor.region is not None and not _linked(anchor, root.region, begin, box):
            raise NotSeparatedError("the branch is not known to be the one before")
        numbers = np.array([[float(x.mid()) for x in form.coefficients] for form in forms]).reshape(-1, self.order)
        slope = (numbers * np.arange(self.order)).sum(axis=1) / box.radius
        end = [form.at_end() for form in forms]
        tau = box.centre + box.radius
        return (middle, whole), _Anchor(region=root.region, end=end, z=numbers.sum(axis=1), slope=slope, tau=tau)

    def _decided(self, i: int, states: tuple[State, State], piece: Piece, box: _Box) -> bool:
        """Record a claim's bound on a box; return False if the box must be halved to decide the claim."""
        if i == _NEAR_PLAN:
            return self.near.takes(states, (box.centre, box.radius), box.halvings, self.order)
        claim, record, (low, high) = self.claims[i], self.records[i], self.marks[i]
        record.boxes += 1
        try:
            ctx.cap = self.order + 2
            middles = claim.values(states[0])
            ctx.cap = self.order + 3
            wholes = claim.values(states[1])
        except (NotSeparatedError, ZeroDivisionError, ValueError):  # flint's divisor may vanish
            return False
        decided = True
        for middle, whole in zip(middles, wholes, strict=True):
            form = TaylorForm.of(middle, whole, self.order)
            verdict = form.verdict(low, high, known=(record.least, record.greatest), size=claim.least_size)
            when = piece.begin_s + (box.centre + verdict.at * box.radius) * float(piece.width)
            if verdict.answer is False:
                record.refuted, record.refuted_at = verdict, when
                return True
            loose = box.halvings < _TIGHTENING_ROUNDS and record.loosened_by(verdict, form, claim)
            decided = decided and bool(verdict.answer) and not loose
            if verdict.answer and not loose:
                record.add(verdict, when)
        return decided

    def _leave(self, piece: Piece, box: _Box, claims: Sequence[int], *, closed: bool) -> None:
        """Record that claims are undecided on a box."""
        begin, end = (piece.begin_s + (box.centre + x * box.radius) * float(piece.width) for x in (-1, 1))
        ends = begin, end
        for i in claims:
            if i == _NEAR_PLAN:
                self.near.failure = f"the limit on time or on the number of boxes was reached at t = {ends[0]:.4g} s"
            else:
                self.records[i].undecided.append(ends)
        if not closed:
            self.closure.undecided.append(ends)

    def findings(self) -> list[Finding]:
        """Return the findings of all claims, the closure first."""
        of_claims = (finding_of_claim(c, r) for c, r in zip(self.claims, self.records, strict=True))
        return [*_closure_findings(self), *of_claims]


def _boxes(halvings: int, claims: list[int]) -> list[_Box]:
    """Return the boxes of an interval after a number of halvings, in reversed order of time."""
    n = 2**halvings
    return [_Box(centre=(k + 0.5) / n, radius=0.5 / n, halvings=halvings, claims=claims) for k in reversed(range(n))]


def states_of(
    blocks: Blocks, piece: Piece, box: tuple[float, float], guess: np.ndarray, slack: Sequence[arb], order: int
) -> tuple[State, State, EnclosedRoot]:
    """Return the states at the middle of a box and over the box, and the root of the closure over the box.

    Args:
        blocks: the mechanism's blocks.
        piece: an interval of the trajectory.
        box: centre and radius in tau.
        guess: the dependent coordinates (rank,) at the centre.
        slack: balls (n_s,) by which the positions for which the root is unique are extended.
        order: the number of coefficients of the Taylor forms.

    Raises:
        NotSeparatedError: if the root cannot be enclosed.
    """
    r, everywhere = arb(box[1]), arb(0, 1)
    along = arb_poly([arb(box[0]), r])
    local = [[p(along) for p in of] for of in (piece.position, piece.velocity, piece.effort, piece.along)]  # of x in [-1, 1]
    point = krawczyk(blocks, [p(arb(0)) for p in local[0]], guess)
    root = krawczyk(blocks, [p(everywhere) + more for p, more in zip(local[0], slack, strict=True)], guess)

    def state(x: arb, z: Sequence[arb], cap: int, middle: State | None = None) -> State:
        ctx.cap = cap
        about = arb_poly([x, 1])
        s, v, u, path = ([arb_series(p(about).coeffs(), prec=cap) for p in of] for of in local)
        half = piece.width * r
        time = arb_series((piece.since + piece.width * along)(about).coeffs(), prec=cap)
        more = {"z": series_of(blocks, s, z, cap), "rate": 1 / half, "time": time}
        return State(blocks=blocks, piece=piece, s=s, v=v, u=u, along=path, middle=middle, **more)

    middle = state(arb(0), point.enclosure, order + 2)
    return middle, state(everywhere, root.enclosure, order + 3, middle), root


def _linked(anchor: _Anchor, region: list[arb], begin: list[arb], box: _Box) -> bool:
    """Return True if the roots of a box, at its begin and in its region, are on the anchor's branch."""
    assert anchor.region is not None  # of the box before
    if all(of.contains(x) for of, x in zip(anchor.region, begin, strict=True)):
        return True
    adjacent = anchor.tau == box.centre - box.radius
    return adjacent and all(of.contains(x) for of, x in zip(region, anchor.end, strict=True))


def _closure_findings(sweep: _Sweep) -> list[Finding]:
    if not sweep.blocks.rank:
        return []
    record, name = sweep.closure, "the loops close, on one branch without a singular pose"
    mark = START_POSE_ERROR
    if sweep.start_gap > mark:
        reason = f"the start pose is {sweep.start_gap:.3g} rad or m from the closed pose"
        return [Finding(name=name, answer="refuted", bound=sweep.start_gap, mark=mark, boxes=record.boxes, reason=reason)]
    if record.undecided:
        return [Finding(name=name, answer="undecided", boxes=record.boxes, reason=undecided_reason(record.undecided))]
    return [
        Finding(
            name=name,
            answer="proved",
            unit="rad or m",
            bound=sweep.start_gap,
            mark=mark,
            margin=mark - sweep.start_gap,
            boxes=record.boxes,
        )
    ]
