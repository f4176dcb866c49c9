"""The result of `bode`: its fields are the record `bode.json`, its methods show margins, plots and further studies."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec import Struct, field
from msgspec.structs import replace

from linkplan.models.errors import ProblemError, choose
from linkplan.models.mechanism import Mechanism
from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.studies.feedback.bode.bode_blocks import margins_along, nyquist, plants, responses, sensitivities
from linkplan.studies.feedback.bode.bode_result import AlongMotion, BodePoint, MapStudy, PoseLoops, WorstMargins
from linkplan.studies.feedback.bode.loop_blocks import along_blocks, large_blocks, map_blocks
from linkplan.studies.feedback.bode.plant_words import agreement_text, modes_text
from linkplan.studies.feedback.bode.scan import Scan, bounds_text
from linkplan.studies.feedback.frequency.describing import LargeSignals
from linkplan.studies.feedback.frequency.feedback_loops import QUANTITIES, SampledLaw
from linkplan.studies.feedback.frequency.margins import LEAST_RESPONSE_AT_REST, Margins, frequency_grid
from linkplan.studies.output.document import Block, Facts, Report, Section, Table, Text, table_of
from linkplan.studies.output.figure_spec import FigureSpec, panels_of, side_by_side
from linkplan.studies.output.paths import drawn
from linkplan.studies.output.plan_blocks import radius_figure
from linkplan.studies.output.report_file import report_of
from linkplan.studies.output.result import MechanismResult

if TYPE_CHECKING:
    import control
    from matplotlib.figure import Figure


class BodeStudy(MechanismResult, Struct, frozen=True, kw_only=True, eq=False, omit_defaults=True):
    """A tracker's loops at several poses, and the margins over the whole reach.

    It is stable if the sampled loop is stable at every pose, by the model and in MuJoCo; at the `disputed` poses the two
    differ. `worst` has the worst margins by joint. `measurement` has the method, the largest difference between measured and
    predicted closed loops at coherent frequencies, and the simulator's settings. `map`, `large` and `along` are additional
    studies, if they were requested.
    """

    record_name = "bode"

    mechanism_name: str = field(name="mechanism")
    stable: bool
    message: str
    tracker: str
    gains: dict[str, Any]
    disputed: tuple[str, ...]
    softness: str | None
    contacts: str | None
    loops: list[PoseLoops] = field(name="points")
    worst: dict[str, WorstMargins]
    measurement: dict[str, Any] | None
    note: str | None  # on the choice of the poses
    map: MapStudy | None = None
    large: LargeSignals | None = None
    along: AlongMotion | None = None
    mechanism: Beside[Mechanism] = field(default=NOT_READ, name="(mechanism)")
    law: Beside[SampledLaw] = NOT_READ
    scans: Beside[tuple[Scan, ...]] = NOT_READ
    is_measured: Beside[bool] = NOT_READ

    @property
    def passed(self) -> bool:
        """Whether the sampled loop is stable at every analysed pose."""
        return self.stable

    @property
    def points(self) -> tuple[BodePoint, ...]:
        """The loops of all joints and poses, joint by joint."""
        every = (loop for at in self.loops for loop in at.loops.values())
        return tuple(sorted(every, key=lambda loop: loop.channel))

    def _of(self, channel: int) -> list[BodePoint]:
        """Return one joint's loops."""
        return [loop for loop in self.points if loop.channel == channel]

    @property
    def loop_name(self) -> str:
        """The tracker with its gains, period and delay, as text."""
        return loop_text(self.mechanism, self.law)

    @property
    def poses(self) -> tuple[str, ...]:
        """The names of the analysed poses, for `lti` and `frd`."""
        return tuple(dict.fromkeys(entry.point.name for entry in self.points))

    def lti(self, pose: str | None = None, *, closed: bool = False) -> "control.StateSpace":
        """Return the sampled loop at a pose as python-control's state space, with its period as `dt` [s].

        The open loop is cut at the actuators: it maps commands u (n_u,) [N.m or N] to the law's output K x (n_u,) of the
        linearised plant. The closed loop maps commands, added to the law's, to the state x = (s, s') (2 n_s,) [rad or m, and
        per second]. Past commands are further states.

        Args:
            pose: one of `poses`; by default the first one.
            closed: whether the loop is closed.

        Raises:
            LinkplanError: for an unknown pose.
        """
        return self._entry(pose, None).sampled.system(closed=closed)

    def frd(
        self, quantity: str = "loop", pose: str | None = None, *, joint: str | None = None, measured: bool = False
    ) -> "control.FrequencyResponseData":
        """Return a response at a pose as python-control's frequency response data, over frequencies in rad/s.

        Args:
            quantity: "plant", "loop", "sensitivity", "complementary", "control", "reference" or "reference+ff"; angles are
                in radians.
            pose: one of `poses`; by default the first one.
            joint: of the loop; by default the first independent joint.
            measured: whether the response is the one measured in MuJoCo, instead of the prediction.

        Raises:
            LinkplanError: for an unknown name, or a response that was not measured.
        """
        entry = self._entry(pose, joint)
        choose("response", quantity, QUANTITIES, ProblemError)
        if measured:
            if quantity not in entry.responses:
                known = ", ".join(entry.responses) or "none"
                raise ProblemError(f"'{quantity}' was not measured at {entry.point.name}; measured: {known}")
            return entry.responses[quantity].frd()
        frequency_hz = frequency_grid(self.law.timing.period_s)[:-1]  # below the Nyquist frequency
        return entry.sampled.response(quantity, frequency_hz, entry.channel).frd()

    def _entry(self, pose: str | None, joint: str | None) -> BodePoint:
        at = choose("pose", self.poses[0] if pose is None else str(pose), self.poses, ProblemError)
        return next(entry for entry in self._of(self._channel(joint)) if entry.point.name == at)

    def _channel(self, joint: str | None) -> int:
        """Return the index of an independent joint, by default of the first one."""
        names = [one.name for one in self.mechanism.independent_joints]
        return names.index(choose("independent joint", names[0] if joint is None else str(joint), names, ProblemError))

    def blocks(self) -> list[Block]:
        """Return the margins at every pose, and the further studies."""
        return [*self.summary(), *(block for section in self._further.values() for block in section.blocks)]

    def summary(self) -> list[Block]:
        """Return the verdict, the margins at every pose, the worst one over the reach, and what was measured."""
        message = self.message[:1].upper() + self.message[1:]
        blocks: list[Block] = [Text(text=message, tone="good" if self.stable else "bad")]
        rows = [("mechanism", self.mechanism.name), ("tracker", self.law.name), ("feedback loop", self.loop_name)]
        if shared := self.points[0].point.shared_coordinates:
            rows.append(("at every pose", shared))
        if len(self.mechanism.channels) > 1:
            names = ", ".join(self.mechanism.independent_joints[k].name for k in self.mechanism.channels)
            text = (
                f"each loop is opened at the total effort on its coordinate ({names}) of"
                f" {', '.join(actuator.name for actuator in self.mechanism.actuators)}; the other loops are closed"
            )
            blocks.append(Text(text=text))
        scans = [Text(text=_worst_of(self, scan)) for scan in self.scans]
        notes = [*crossovers_of(self), self.contacts, self.softness, self.note]
        said = [Text(text=note, tone="note") for note in notes if note]
        return [*blocks, Facts(rows=[*rows, *_measured(self)]), _margins(self), *_plant(self), *scans, *said]

    @property
    def _further(self) -> dict[str, Section]:
        found: dict[str, Section] = {}
        if (stable := self.map) is not None:
            found["map"] = Section(title="Stability map", blocks=map_blocks(stable), depth=2)
        if (large := self.large) is not None:
            found["large"] = Section(title="Large signals", blocks=large_blocks(large), depth=2)
        if (along := self.along) is not None:
            found["along"] = Section(title="Along the motion", blocks=along_blocks(along), depth=2)
        return found

    def document(self) -> Report:
        """Return the report."""
        first, *rest = self.sections(f"{self.mechanism.name}, {self.law.name}")
        first = replace(first, blocks=first.blocks[1:])  # the page's header has the verdict
        sections = [first, *rest, *self._further.values()]
        return report_of(f"Feedback loop of {self.mechanism.name}", self.message, self.stable, sections)

    def sections(self, name: str) -> list[Section]:
        """Return the sections of the loop, the first with the verdict; `name` is for titles and the cursor."""
        group, joints, channels = f"frequency:{name}", self.mechanism.independent_joints, self.mechanism.channels
        found: list[tuple[str, list[Block]]] = [(f"Feedback loop: {name}", self.summary())]
        for channel in channels:
            of = "" if len(channels) == 1 else f" of {joints[channel].name}"
            entries = self._of(channel)
            plots = [plot for both in responses(self.law, entries, group).values() for plot in both]
            further = [nyquist(self.law, entries), *sensitivities(entries, group), *plants(entries, group)]
            found.append((f"Frequency response{of}", [*plots, *further]))
        for scan in self.scans:
            name_of, line = joints[scan.channel].name, scan.line.name
            of = "" if len(channels) == 1 else f" of the loop of {name_of}"
            panels = margins_along(self.law, self.points, scan, f"{name}:{name_of}")
            found.append((f"Margins{of} over {line}", [*panels]))
        return [Section(title=title, blocks=blocks, depth=1 + (k > 0)) for k, (title, blocks) in enumerate(found)]

    def figure_specs(self) -> Iterator[tuple[str, FigureSpec]]:
        """Yield bode, nyquist, sensitivity, margins, with undriven joints plant, and the figures of further studies."""
        joints, title = self.mechanism.independent_joints, f"{self.mechanism.name}, {self.law.name}: {self.loop_name}"
        channels = self.mechanism.channels
        suffixes = {channel: f"-{joints[channel].name}" if len(channels) > 1 else "" for channel in channels}
        for channel, suffix in suffixes.items():
            entries = self._of(channel)
            yield f"bode{suffix}", self._figure(entries)
            yield f"nyquist{suffix}", FigureSpec(panels=[nyquist(self.law, entries)], title=title, panel_in=(6.4, 7.0))
            yield f"sensitivity{suffix}", FigureSpec(panels=sensitivities(entries, ""), title=title, columns=3)
            if moved := plants(entries, ""):
                yield f"plant{suffix}", FigureSpec(panels=moved, title=title, columns=2, panel_in=(6.0, 2.9))
        for scan in self.scans:
            panels = margins_along(self.law, self.points, scan, "")
            yield f"margins{suffixes[scan.channel]}", FigureSpec(panels=panels, title=title, panel_in=(8.0, 3.5))
        for name, section in self._further.items():
            panels = panels_of(section.blocks)
            yield name, FigureSpec(panels=panels, title=section.title, columns=3, panel_in=(6.0, 4.6))

    def _figure(self, entries: Sequence[BodePoint]) -> FigureSpec:
        """Return the figure of the open-loop and closed-loop responses at every pose."""
        how = "line: predicted, sampled; dotted: continuous"
        how += "; dots: MuJoCo, sinestream" if any(entry.responses for entry in entries) else ""
        title = f"{self.mechanism.name}, {self.law.name}: {self.message}; {how}"
        panels = side_by_side(*responses(self.law, entries, "").values())
        return FigureSpec(panels=panels, title=title, columns=2, panel_in=(6.0, 2.9))

    def plot(self, path: str | Path | None = None, *, joint: str | None = None) -> "Figure":
        """Return the figure of the open-loop and closed-loop responses at every pose, saved at `path` if it is given.

        Args:
            path: of the picture.
            joint: of the loop, for several degrees of freedom; by default the first independent joint.

        Raises:
            LinkplanError: if the joint is not independent.
        """
        channel = self._channel(joint)
        return drawn(path, lambda: self._figure(self._of(channel)))


def loop_text(mechanism: Mechanism, law: SampledLaw) -> str:
    """Return the tracker with its gains, period and delay, as text."""
    settings, timing = law.settings, law.timing
    name = law.name if law.by_errors else settings.gains_text(mechanism.independent_joints)
    name += f" sampled every {settings.period_s:g} s"
    if timing.delay_steps:
        periods = timing.delay_s / settings.period_s
        name += f" with a delay of {periods:g} period{'' if periods == 1 else 's'}"
    return name


def _measured(study: BodeStudy) -> list[tuple[str, str]]:
    """Return the agreement of measurement and prediction, or the reason why nothing was measured."""
    if (c := study.measurement) is not None:
        text = agreement_text(c, "closed_loop_deviation_db", "closed_loop_deviation_deg", study.mechanism)
        return [("measured closed-loop responses", text)]
    if not study.is_measured:
        return []
    why = "an unstable feedback loop holds no operating point"
    if any(point.stable for point in study.points):
        why = "there are contacts at the poses at which the feedback loop is stable"
    return [("not measured", why)]


def _margins(study: BodeStudy) -> Table:
    mechanism = study.mechanism
    several = len(mechanism.channels) > 1
    inertias = " or ".join(dict.fromkeys(joint.inertia_unit for joint in mechanism.independent_joints))
    heads = ["loop" if several else "pose", f"inertia [{inertias}]", "stable", "settles in MuJoCo"]
    heads += ["largest pole", "gain margin [dB]", "phase margin [deg]", "delay margin [ms]", "disk margin", "crossover [Hz]"]
    heads += ["bandwidth [Hz]", "resonance [dB]", "peak of |S|"]
    lowered = any(_less_gain_is_nearer(entry) for entry in study.points)
    heads += ["gain reduction margin [dB]"] if lowered else []
    differs = any(entry.stable and (entry.machine_spectral_radius or 0.0) >= 1 for entry in study.points)
    heads += ["largest pole of the machine"] if differs else []
    # A small step settles farther from its reference than `tune` allows; the record always has the response.
    at_rest = [entry.response_at_rest for entry in study.points if entry.response_at_rest is not None]
    pulled = any(abs(1.0 - response) > 1.0 - LEAST_RESPONSE_AT_REST for response in at_rest)
    heads += ["response at rest"] if pulled else []
    rows = []
    for entry in study.points:
        m, name = entry, entry.point.name
        delay = None if m.delay_margin_s is None else 1e3 * m.delay_margin_s
        figures = [m.gain_margin_db, m.phase_margin_deg, delay, m.disk_margin]
        figures += [m.crossover_hz, m.bandwidth_hz, m.resonance_db, m.sensitivity_peak]
        figures += [m.gain_reduction_margin_db] if lowered else []
        figures += [radius_figure(entry.machine_spectral_radius)] if differs else []
        figures += [m.response_at_rest] if pulled else []
        inertia = entry.point.inertia[entry.channel, entry.channel]
        verdicts = [bool(m.stable), bool(entry.settles_in_mujoco), radius_figure(m.spectral_radius)]
        loop = f"{mechanism.independent_joints[entry.channel].name} at {name}" if several else name
        rows.append([loop, inertia, *verdicts, *figures])
    return table_of("Margins at every pose", heads, rows)


def _plant(study: BodeStudy) -> list[Table]:
    """Return the table of the plants' modes, if undriven joints move along."""
    heads, rows = ["loop", "to", "anti-resonances [Hz]", "damping", "resonances [Hz]", "damping"], []
    for entry in study.points:
        for joint, modes in (entry.plant or {}).items():
            swings = *modes_text(modes.anti_resonances), *modes_text(modes.resonances)
            rows.append([f"{entry.broken_at} at {entry.point.name}", joint, *swings])
    return [table_of("Plant: resonances and anti-resonances", heads, rows)] if rows else []


def _less_gain_is_nearer(m: Margins) -> bool:
    """Tell if a lower gain loses stability before a higher gain does. The record always has the margin."""
    less, more = m.gain_reduction_margin_db, m.gain_margin_db
    return less is not None and (more is None or less < more)


_LEAST_MARGINS = (
    ("gain_margin_db", "gain margin", "dB"),
    ("gain_reduction_margin_db", "gain reduction margin", "dB"),
    ("phase_margin_deg", "phase margin", "deg"),
)


def _worst_of(study: BodeStudy, scan: Scan) -> str:
    line, joints = scan.line, study.mechanism.independent_joints
    ends = f"{line.text(scan.positions[0], 4)} to {line.text(scan.positions[-1], 4)} {line.unit}"
    of_loop = "" if len(joints) == 1 else f" of the loop of {joints[scan.channel].name}"
    worst = f"{line.place(scan.positions[scan.worst])}: {bounds_text(scan.margins[scan.worst])}"
    text = f"over {line.name} from {ends} the worst{of_loop} is {worst}"
    lowered = any(map(_less_gain_is_nearer, scan.margins))
    for name, words, unit in _LEAST_MARGINS:
        told = all(m.stable for m in scan.margins) and (lowered or name != "gain_reduction_margin_db")
        least = scan.least(name) if told else None
        if least is not None:
            text += f"; least {words} {least[0]:.3g} {unit} at {line.place(scan.positions[least[1]])}"
    return text


def crossovers_of(study: BodeStudy) -> list[str]:
    """Return a sentence on the feedback loops whose gain crosses 1 several times; an empty list if there are none."""
    several = [entry for entry in study.points if entry.other_crossovers_hz]
    if not several:
        return []
    others = [f for entry in several for f in entry.other_crossovers_hz]
    low, high = (f"{of(others):.4g}" for of in (min, max))
    at = low if low == high else f"{low} to {high}"
    where = f"in {len(several)} of {len(study.points)} loops" if len(several) > 1 else f"at {several[0].point.name}"
    return [f"{where} the gain also crosses 1 at {at} Hz; the phase margin shown is the smallest of all crossings"]
