"""Batches of short problems, and what two results of one must have in common."""

import json

from linkplan.planner.problem.keys.sections import BatchFile, CaseSection


def swept(n):
    """A batch of n cases that take a tenth of a second each, one of them impossible."""
    cases = [CaseSection(name=f"{i}", set=[f"motion.goal_deg.O={-40 + i}"]) for i in range(n)]
    cases[1] = CaseSection(name="1", set=["motion.duration_s=0.001"])
    return BatchFile(problem="knee-reach", set=["mesh.intervals=10", "mesh.tolerance_deg=0.01"], case=cases)


def same_plans(first, second, n):
    """Fail where two results differ in anything but the seconds that they took."""
    names = [str(i) for i in range(n) if i != 1]
    assert sorted(path.name for path in first.iterdir()) == sorted([".linkplan.json", "batch.json", "report.json", *names])
    for name in names:
        for file in ("trajectory.npz", "trajectory.csv"):
            assert (first / name / file).read_bytes() == (second / name / file).read_bytes()
    assert untimed(first) == untimed(second)


def untimed(folder):
    record = json.loads((folder / "batch.json").read_text())
    for case in record["cases"].values():
        del case["time_s"]
        for step in case["history"]:
            del step["build_s"], step["solve_s"]
    return record
