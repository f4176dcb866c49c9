"""The study of `bode` with inputs and outputs: the plant from efforts to positions, predicted and measured."""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from msgspec import structs

from linkplan.controllers.sampling import Sampling
from linkplan.controllers.trackers.names import BUILT_IN
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.contacts import contact_pairs
from linkplan.planner.problem.settings import Tracking
from linkplan.planner.search.planning import silent
from linkplan.studies.feedback.bode.bode import law_at, softness_of
from linkplan.studies.feedback.bode.bode_result import pose_values
from linkplan.studies.feedback.bode.plant_blocks import PlantStudy
from linkplan.studies.feedback.bode.plant_words import (
    LARGEST_UNCERTAINTY,
    PlantCurve,
    PlantPoint,
    PlantResponse,
    Root,
    plant_message,
)
from linkplan.studies.feedback.bode.scan import contact_sentence, touched
from linkplan.studies.feedback.frequency.excitation import Measurement, Setup
from linkplan.studies.feedback.frequency.feedback_loops import (
    FeedbackLoop,
    OperatingPoint,
    SampledLaw,
    feedback_loop,
    label_differences,
)
from linkplan.studies.feedback.frequency.plant_sinestream import decay_time_s, measure_plants, sampled_gains
from linkplan.studies.feedback.frequency.ports import (
    PlantInput,
    PlantOutput,
    gain_unit,
    pair_name,
    plant_input,
    plant_output,
)
from linkplan.studies.feedback.frequency.response import Response, largest_deviation
from linkplan.studies.feedback.frequency.simulated_loops import settle_trials
from linkplan.studies.feedback.frequency.transfer_function import (
    TransferFunction,
    in_right_half_plane,
    modes_of,
    plant_transfer,
)

# Number of decades drawn below a response's slowest root and above its fastest root.
_DRAWN_DECADES = 1.0
# Number of frequencies of a curve: evenly spaced, and near each resonance and anti-resonance, whose peaks are narrow.
_EVEN_POINTS, _POINTS_BESIDE, _BESIDE_SHARES = 260, 12, (1e-4, 0.1)
# Default frequencies: their number, from a third of the lowest mode to three times the highest, at most this range.
_MEASURED_POINTS, _MEASURED_BEYOND, _MEASURED_RANGE, _MEASURED_MODES = 20, 3.0, 300.0, 10
_LEAST_DAMPING = 1e-3
# Largest number of simulator steps of all simulations together (some minutes), and the cycles of each simulation.
_MOST_STEPS, _LEAST_CYCLES = 2_000_000, 5.0
# The highest default frequency as a share of the sampling rate, and the centre for a plant without modes.
_HIGHEST_SHARE, _CENTRE_SHARE = 0.45, 0.05


def plant_study(
    mechanism: Mechanism,
    positions: np.ndarray,
    efforts: Sequence[str],
    outputs: Sequence[str],
    settings: Tracking,
    effort_limit: np.ndarray,
    say: Callable[[str], None] = silent,
    *,
    law: str = "pd",
    setup: Setup | None = None,
    frequency_hz: np.ndarray | None = None,
    note: str | None = None,
) -> PlantStudy:
    """Return the plant from efforts to positions about independent positions (n, n_s) [rad or m].

    Args:
        mechanism: with an actuator.
        positions: the poses.
        efforts: names of the inputs, see `ports`.
        outputs: names of the outputs.
        settings: gains, period and delay of the tracker that holds the plant while it is measured.
        effort_limit: (n_u, 2) [N.m or N].
        say: receives progress messages.
        law: pd, pd+ff or lqr.
        setup: settings of the measurement; None measures nothing.
        frequency_hz: (m,) to measure at; None for twenty around the resonances.
        note: on the choice of the positions, for the report.

    Raises:
        LinkplanError: for an unknown name, a pose that cannot be held, or frequencies above the Nyquist frequency.
    """
    ins, outs = _ports(mechanism, efforts, outputs)
    chosen, points = law_at(mechanism, np.atleast_2d(positions), law, settings, effort_limit, frequency_hz)
    points = label_differences(points)
    transfers: list[dict[str, TransferFunction]] = []  # by `pair_name`, at each point
    for point in points:
        say(f"predicted at {point.name}")
        ways = ((pair_name(one, out), one.push(point), out.slopes(point.pose)) for one, out in itertools.product(ins, outs))
        transfers.append({name: plant_transfer(point, push, slopes) for name, push, slopes in ways})
    grid = _curve_frequencies([one for found in transfers for one in found.values()], chosen.timing.period_s)
    held: list[tuple[str, FeedbackLoop] | None] = [None] * len(points)
    pairs = contact_pairs(mechanism, np.array([point.pose for point in points]))
    taken, measured, caveats = None, {}, ()
    moved = [out for out in outs if any(found[pair_name(one, out)].gain for found in transfers for one in ins)]
    if setup is not None and moved:
        in_contact = touched(pairs, len(points))
        held = _holding_loops(points, chosen, in_contact)
        kept = {i: one[1] for i, one in enumerate(held) if one is not None}
        if kept:
            at = frequency_hz
            if at is None:
                at = plant_frequencies(transfers, chosen.timing, len(kept) * mechanism.n_u)
            taken = measure_plants(list(kept.values()), ins, moved, at, effort_limit, setup, say)
            # An output that does not move at a pose would only be measured as noise.
            measured = {
                i: {name: one for name, one in of.items() if transfers[i][name].gain}
                for i, of in zip(kept, taken.responses, strict=True)
            }
        caveats = tuple(_caveats(points, held, in_contact, measured, BUILT_IN[law].words))
    found = tuple(
        _point(point, ins, outs, transfers[i], grid, held[i], measured.get(i, {})) for i, point in enumerate(points)
    )
    return PlantStudy(
        mechanism_name=mechanism.name,
        message=plant_message(found, efforts, outputs),
        inputs=tuple(efforts),
        outputs=tuple(outputs),
        points=found,
        measurement=_measurement(found, taken),
        caveats=caveats,
        contacts=contact_sentence(pairs, len(points)) if setup is not None else None,
        softness=softness_of(points) if setup is not None else None,
        note=note,
        mechanism=mechanism,
        efforts=ins,
        positions=outs,
    )


def _measurement(points: Sequence[PlantPoint], taken: Measurement | None) -> dict[str, Any] | None:
    """Return the conditions of a measurement and its largest deviation from the prediction; None without one."""
    if taken is None:
        return None
    every = [one.measured for point in points for one in point.responses.values() if one.measured]
    db, deg = largest_deviation(every, LARGEST_UNCERTAINTY)
    return {"method": "sinestream", "simulated_steps": taken.simulated_steps, "deviation_db": db, "deviation_deg": deg} | (
        taken.conditions
    )


def _ports(
    mechanism: Mechanism, efforts: Sequence[str], outputs: Sequence[str]
) -> tuple[tuple[PlantInput, ...], tuple[PlantOutput, ...]]:
    for what, names in (("from_effort", efforts), ("to_position", outputs)):
        if not names or len(set(names)) < len(names):
            raise LinkplanError(f"{what} must name one or more, each once, got {', '.join(names) or 'none'}")
    return (
        tuple(plant_input(mechanism, name, "from_effort") for name in efforts),
        tuple(plant_output(mechanism, name, "to_position") for name in outputs),
    )


def _holding_loops(
    points: Sequence[OperatingPoint], law: SampledLaw, in_contact: np.ndarray
) -> list[tuple[str, FeedbackLoop] | None]:
    """Return, for each point, the tracker's loop or the plant by itself, whichever settles first in MuJoCo; else None."""
    held: list[tuple[str, FeedbackLoop] | None] = [None] * len(points)
    nothing = np.zeros((len(law.effort_limit), 2 * points[0].mechanism.dof))
    makers: dict[str, Callable[[OperatingPoint], FeedbackLoop]] = {
        law.name: law.loop,
        "itself": lambda point: feedback_loop(point, nothing, law.timing),
    }
    for name, make in makers.items():
        loops: dict[int, FeedbackLoop] = {}
        for i in [i for i, one in enumerate(held) if one is None and not in_contact[i]]:
            try:
                loops[i] = make(points[i])
            except LinkplanError:  # LQR has no stabilising gain
                continue
        stable = {i: loop for i, loop in loops.items() if loop.stable}
        if stable:
            settles = settle_trials(list(stable.values()), law.effort_limit)
            for i, does in zip(stable, settles, strict=True):
                held[i] = (name, stable[i]) if does else None
    return held


def _caveats(
    points: Sequence[OperatingPoint],
    held: Sequence[tuple[str, FeedbackLoop] | None],
    in_contact: np.ndarray,
    measured: dict[int, dict[str, Response]],
    law: str,
) -> Iterator[str]:
    """Yield the reason why nothing is measured at a pose, or how many gains there had not settled."""
    for i, (point, one) in enumerate(zip(points, held, strict=True)):
        if in_contact[i]:
            yield f"not measured at {point.name}: there are contacts"
        elif one is None:
            yield f"not measured at {point.name}: neither the loop of {law} nor the plant by itself settles in MuJoCo"
        else:
            known = [bool(gain) for taken in measured[i].values() for gain in taken.is_known(LARGEST_UNCERTAINTY)]
            if not all(known):
                decay_s = decay_time_s(one[1])
                yield (
                    f"{known.count(False)} of {len(known)} measured gains at {point.name} had not settled and are not"
                    f" drawn: oscillations decay in {decay_s:.3g} s; other gains or another tracker may damp more"
                )


def _point(
    point: OperatingPoint,
    ins: Sequence[PlantInput],
    outs: Sequence[PlantOutput],
    transfers: dict[str, TransferFunction],
    grid: np.ndarray,
    held: tuple[str, FeedbackLoop] | None,
    measured: dict[str, Response],
) -> PlantPoint:
    """Return the plant at a point, with its measured responses by input and output."""
    responses = {}
    for one, out in itertools.product(ins, outs):
        name = pair_name(one, out)
        found, taken = response_of(transfers[name], gain_unit(one, out), grid), measured.get(name)
        if held is not None and taken is not None:
            loop, ways = held[1], (one.push(point), out.slopes(point.pose))
            below = grid[grid < loop.timing.nyquist_hz]
            predicted = [
                Response(frequency_hz=f, gain=sampled_gains(loop, *ways, f), unit=found.unit, origin="predicted, sampled")
                for f in (below, taken.frequency_hz)
            ]
            found = structs.replace(found, measured=taken.beside(predicted[1]), sampled=_curve(predicted[0]))
        responses[name] = found
    return PlantPoint(**pose_values(point), held_by=held[0] if held else None, responses=responses, point=point)


def response_of(transfer: TransferFunction, unit: str, grid: np.ndarray) -> PlantResponse:
    """Return a transfer function as a response [unit] with its curve over frequencies (n,) [Hz]."""
    moves = transfer.gain != 0.0
    low, order = (transfer.low_frequency_gain, transfer.integrators) if moves else (0.0, 0)
    curve = Response(frequency_hz=grid, gain=transfer.at(grid), unit=unit, origin="predicted") if moves else None
    return PlantResponse(
        unit=unit,
        moves=moves,
        integrators=order,
        relative_degree=transfer.relative_degree,
        low_frequency_gain=low,
        gain_at_rest=None if order > 0 else low if order == 0 else 0.0,
        resonances=modes_of(transfer.poles),
        anti_resonances=modes_of(transfer.zeros),
        poles=_roots(transfer.poles),
        zeros=_roots(transfer.zeros),
        unstable_poles=_roots(in_right_half_plane(transfer.poles)),
        right_half_plane_zeros=_roots(in_right_half_plane(transfer.zeros)),
        curve=None if curve is None else _curve(curve),
        transfer=transfer,
    )


def _roots(values: np.ndarray) -> tuple[Root, ...]:
    """Return roots, each pair once."""
    return tuple(Root(real_rad_s=float(x.real), imaginary_rad_s=float(x.imag)) for x in values if x.imag >= 0)


def _curve(response: Response) -> PlantCurve:
    phase = response.phase_deg - 360.0 * np.round(response.phase_deg[0] / 360.0)
    return PlantCurve(frequency_hz=response.frequency_hz, gain_db=response.gain_db, phase_deg=phase)


def _curve_frequencies(transfers: Sequence[TransferFunction], period_s: float) -> np.ndarray:
    """Return the frequencies (n,) [Hz] of all curves: evenly spaced on a logarithmic axis, and close beside each mode."""
    roots = np.concatenate([np.concatenate([one.poles, one.zeros]) for one in transfers])
    sizes = np.abs(roots[roots != 0]) / (2 * np.pi)
    sizes = sizes if sizes.size else np.array([_CENTRE_SHARE / period_s])
    ends = sizes.min() / 10**_DRAWN_DECADES, sizes.max() * 10**_DRAWN_DECADES
    away = np.geomspace(*_BESIDE_SHARES, _POINTS_BESIDE)
    swings = np.unique(np.round(np.abs(roots[roots.imag > 0]) / (2 * np.pi), 9))
    beside = np.outer(swings, np.concatenate([1.0 - away, 1.0 + away])).ravel()
    return np.unique(np.concatenate([np.geomspace(*ends, _EVEN_POINTS), beside]))


def plant_frequencies(transfers: Sequence[Mapping[str, TransferFunction]], timing: Sampling, n_rows: int) -> np.ndarray:
    """Return twenty frequencies [Hz] around the modes of all responses, or else around their other roots.

    They start higher if so many rows of simulations would take long.

    Up to ten damped modes are measured too. At an undamped mode no effort is needed, so none can be measured.
    """
    roots = np.concatenate([np.concatenate([one.poles, one.zeros]) for found in transfers for one in found.values()])
    some = roots[roots.imag > 0]
    some = some if some.size else roots[roots != 0]
    some = some if some.size else np.array([2 * np.pi * _CENTRE_SHARE / timing.period_s], dtype=complex)
    sizes = np.abs(some) / (2 * np.pi)
    high = min(_MEASURED_BEYOND * sizes.max(), _HIGHEST_SHARE / timing.period_s)
    low = max(min(sizes.min(), high / _MEASURED_BEYOND) / _MEASURED_BEYOND, high / _MEASURED_RANGE)
    even = np.geomspace(low, high, _MEASURED_POINTS)
    while n_rows * _LEAST_CYCLES * np.sum(1 / even) > _MOST_STEPS * timing.timestep_s and even[0] < high / _MEASURED_BEYOND:
        even = np.geomspace(1.2 * even[0], high, _MEASURED_POINTS)
    low = even[0]
    damped = np.sort(sizes[(sizes > low) & (sizes < high) & (np.abs(some.real) > _LEAST_DAMPING * np.abs(some))])
    modes = damped[np.diff(np.log(damped), prepend=-np.inf) > np.log(even[1] / even[0]) / _MEASURED_MODES]
    return np.union1d(even, modes) if some.imag.any() and len(modes) <= _MEASURED_MODES else even
