"""Figure of a tracked loop along a motion: frozen margins, and the decay of a disturbance, predicted and measured."""

from pathlib import Path

import numpy as np

from linkplan.studies.bode.along_motion import AlongMotion
from linkplan.studies.output.drawing import BLUE, GREY, ORANGE, page


def along_figure(found: AlongMotion, path: Path) -> None:
    """Draw the frozen margins over time and, for a periodic motion, the decay over a cycle."""
    columns = 1 if found.floquet is None else 2
    with page(path, rows=1, columns=columns, size=(6.2 * columns, 4.2)) as axes:
        draw_frozen(axes[0, 0], found)
        if found.floquet is not None:
            draw_decay(axes[0, 1], found)
        name = found.plan.problem.name
        axes[0, 0].figure.suptitle(f"{found.plan.problem.mechanism.name}, {found.law} along {name}", fontsize=10.5)


def draw_frozen(axes, found: AlongMotion) -> None:
    """Draw phase and disk margins of the loop frozen at instants of the motion."""
    time = 1e3 * found.reference.time_s[found.instants]
    for name, label, colour in (
        ("phase_margin_deg", "phase margin", BLUE),
        ("disk_phase_margin_deg", "disk phase margin", ORANGE),
    ):
        values = [np.nan if getattr(m, name) is None else getattr(m, name) for m in found.margins]
        axes.plot(time, values, "o-", color=colour, markersize=3, label=label)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("time [ms]")
    axes.set_ylabel("margin [deg]")
    several = found.plan.problem.mechanism.dof > 1
    axes.set_title("frozen at each instant" + (", the worst coordinate's loop" if several else ""))
    axes.legend(loc="best")


def draw_decay(axes, found: AlongMotion) -> None:
    """Draw the remaining share of the worst disturbance over a cycle: predicted, and measured while above rounding."""
    cycle = found.floquet
    shown = slice(0, cycle.last_visible_sample + 1)
    time = 1e3 * cycle.time_s
    axes.semilogy(time, np.where(cycle.size >= 1e-12, cycle.size, np.nan), color=BLUE, linewidth=1.6, label="predicted")
    axes.semilogy(time[shown], cycle.measured_size[shown], color=ORANGE, linestyle="--", linewidth=1.6, label="MuJoCo")
    axes.axhline(1.0, color=GREY, linestyle=":", linewidth=1.0)
    axes.set_xlabel("time [ms]")
    axes.set_ylabel("remaining share of the worst disturbance")
    axes.set_title(f"largest multiplier {np.abs(cycle.multipliers[0]):.3g} a cycle")
    axes.legend(loc="best")
