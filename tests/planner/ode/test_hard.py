"""Problems that other programs publish with a warning: limits along which a motion is unstable, rates that are singular."""

import casadi as ca
import pytest

from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.ode.starts import integrated
from tests.support.ode import FREE_EFFORT, NAN, solved
from tests.support.tolerances_planner import FIVE_DIGITS, ODE_CLOSED_FORM

# The bioreactor with rates constant over 100 and over 400 equal cells, by Runge and Kutta's rule in steps of 1/40 and multiple
# shooting: 6.1515914 and 6.1516030, and what these tend to with the square of the cells' width.
LEE_RAMIREZ = 6.1516037
