"""A leg of two motors whose knee is a four-bar, its reach, and the refinement of a motion of several motors."""

import numpy as np

import linkplan
from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.closed_chain.guess import first_guess
from linkplan.planner.refinement.case import attempt
from linkplan.planner.search import finer_meshes, multistart
from linkplan.planner.transcription.mesh import uniform
from tests.support.data import DATA

LEG = DATA / "leg_with_four_bar_knee.xml"
LOAD = {"body": "shank", "mass_kg": 1.5, "com_m": [0.0, 0.0, 0.0], "inertia_kgm2": [1e-3, 1e-3, 1e-3]}
ENDS = {"start_deg": {"hip_pitch": 20.0, "knee_motor": 5.0}, "goal_deg": {"hip_pitch": -50.0, "knee_motor": 38.0}}


def leg(payload=None, limits=None, **asked):
    mechanism = linkplan.load_mechanism(LEG, payload=payload)
    limits = {"contacts": "note"} | (limits or {})
    return linkplan.Problem.reach(mechanism, **ENDS, **asked, mesh={"intervals": 40}, limits=limits)


def refined(problem, start_s: float):
    """Return the refined motion of a problem, from a motion on a coarse mesh that begins at a duration."""
    first = multistart._first_case(case_of(problem).problem, problem.start_pose())
    guess = first_guess(problem, problem.start_pose())
    return finer_meshes.refine_several(case_of(problem), attempt(first, guess, uniform(24), np.array([start_s]), "first"))
