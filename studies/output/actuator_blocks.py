"""What a plan demands of each actuator: a table, and effort over speed with the limits and the torque-speed line."""

import numpy as np

from linkplan.planner.certificate.demands import demands_of, operating_points, shown_speed
from linkplan.planner.plan.plan import Plan
from linkplan.studies.output.document import Axis, Block, Plane, Series, Table, table_of
from linkplan.studies.output.numbers import drawn_rows, rounded

_HEADS = [
    "actuator",
    "peak effort",
    "rms effort",
    "unit",
    "peak speed",
    "its unit",
    "power as motor [W]",
    "as brake [W]",
    "energy given [J]",
    "taken [J]",
]


def demand_table(plan: Plan) -> Table:
    """Return the demands of a plan with a motion, an actuator in a row."""
    rows = [
        [
            one.actuator,
            one.peak_effort,
            one.rms_effort,
            one.effort_unit,
            one.peak_speed,
            one.speed_unit,
            one.peak_motor_power_w,
            one.peak_brake_power_w,
            one.energy_given_j,
            one.energy_taken_j,
        ]
        for one in demands_of(plan.problem, plan.require_motion("judge actuators by"))
    ]
    return table_of("What the motion demands of each actuator", _HEADS, rows, brief=[])


def demand_blocks(plan: Plan, group: str) -> list[Block]:
    """Return the table of demands, and the chart of each actuator's effort over its speed with what limits it."""
    problem, motion = plan.problem, plan.require_motion("draw")
    time = motion.dense_times(20)
    speed, effort, _ = operating_points(problem, motion, time)
    found: list[Block] = [demand_table(plan)]
    for j, actuator in enumerate(problem.mechanism.actuators):
        per_unit, unit = shown_speed(actuator.si_units[0])
        rows = drawn_rows(np.column_stack([speed[:, j], effort[:, j]]))
        fastest = 1.15 * per_unit * float(np.abs(speed[:, j]).max()) or 1.0
        curves = [
            Series(name="limit" if first else "", x=[-fastest, fastest], y=[end, end], look="dash", colour=4)
            for first, end in zip((True, False), problem.limits.effort[j].tolist(), strict=True)
            if np.isfinite(end)
        ]
        motor = problem.motors[j]
        if motor is not None and motor.line is not None:
            stall, no_load = motor.line[0], per_unit * motor.line[1]
            ends = np.array([-fastest, fastest])
            curves += [
                Series(
                    name="torque-speed line" if side > 0 else "",
                    x=rounded(ends),
                    y=rounded(stall * (side - ends / no_load)),
                    look="dots",
                    colour=1,
                )
                for side in (1, -1)
            ]
        planned = Series(
            name="planned",
            x=rounded(per_unit * speed[rows, j]),
            y=rounded(effort[rows, j]),
            colour=None,
            width=2.2,
        )
        found.append(
            Plane(
                title=f"Effort of {actuator.name} over its speed",
                x_axis=Axis(label=f"speed of {actuator.name}", unit=unit),
                y_axis=Axis(label=f"effort of {actuator.name}", unit=actuator.unit),
                curves=[*curves, planned],
                group=group,
                track=len(curves),
                track_times=rounded(time[rows] - motion.breaks_s[0]),
                period=motion.duration_s if motion.periodic else None,
            )
        )
    return found
