"""A short reach of the built-in five-bar between two poses, within limits that tests choose."""


def five_bar_reach(limits: dict, **motion) -> dict:
    """Return the tables of a reach in least time, or with least effort where `motion` gives it a duration."""
    motion = {"duration_s": "free"} | motion
    return {
        "mechanism": {"model": "five-bar"},
        "motion": {
            "kind": "reach",
            "start_deg": {"O1": -90.0, "O2": -90.0},
            "goal_deg": {"O1": -112.0, "O2": -75.0},
            **motion,
        },
        "objective": {"minimize": "time" if motion["duration_s"] == "free" else "effort"},
        "limits": limits,
    }
