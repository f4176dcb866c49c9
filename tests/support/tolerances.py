"""The tests' tolerances, one per quantity: what each protects, and what it was measured from.

"Relative" means: to the largest entry of the expected array, see `relative_error`. Measured values are the worst of the
tests here with MuJoCo 4.0.0 and CasADi 3.8.2 on x86-64; a tolerance stands well above, for other compilers' rounding, and
well below what a wrong term would show.
"""

import numpy as np

# Tree dynamics against MuJoCo's, relative: only rounding separates two evaluations of one formula. Measured 1e-14 (bias).
TREE = 1e-12
# Joint acceleration of an open tree, relative: rounding times the mass matrix's condition. Measured 5e-13.
TREE_ACCELERATION = 1e-10
# Energy, relative to its largest value over the states. Measured 3e-15.
ENERGY = 1e-12
# Closure residual [m] and its Jacobian [m/rad] at coordinates of order 1 m. Measured 7e-16.
CLOSURE = 1e-13
# Pose angle [rad] against the closed form: the closure gap, over links of 15 mm and up and a transmission of 0.05 and up.
# Measured 2e-14 where Newton's last step left rounding; 1e-11 m of gap, all that is promised, would show 1e-8.
ANGLE_RAD = 1e-10
# Values of the reference knee, relative: tabulated to 16 digits. Measured 6e-12, at gravity's zero crossing.
KNEE = 1e-9
# Extremes of the sinusoid's torque, relative: between 4001 samples the peak is missed to second order. Measured 2e-7.
SAMPLED_PEAK = 1e-6
# Reduced quantities against null spaces and moment maps, relative: rounding times the condition of J_z. Measured 2e-12.
REDUCED = 1e-10
# MuJoCo's soft constraint extrapolated in (1 - d) / d from impedances d = 0.999 and 0.9999, relative: what is left is of
# second order, 1e-3 * 1e-4 times a factor of the effective masses. Measured 4e-7; unextrapolated it would be 1e-3.
SOFT_LIMIT = 1e-5
# Five-point central differences with a step of 1e-3 rad, relative: h^4 / 30 of the fifth derivative. Measured 1e-8.
DIFFERENCES = 1e-7
# Energy gained against work less dissipation, relative to the larger of the two, integrated to 1e-11. Measured 2e-11.
POWER = 1e-9
# Closure gap [m] after integrating every joint's rate for a second to 1e-11. Measured 4e-13.
INTEGRATED_GAP = 1e-10
# Singular position [rad or m] against the law of cosines: Newton on phi = 0, det J_z = 0. Measured 9e-15.
SINGULAR_RAD = 1e-9
# Dead centres and range ends [rad or m], bracketed to 1e-14 along closed poses. Measured 1e-13.
BRACKET_RAD = 1e-10
# Where a refused path says that the loop came apart [deg]: six digits are printed, steps end at 4e-7 rad.
APART_DEG = 1e-3
# A length in an error message, relative: three digits are printed.
PRINTED_GAP = 6e-3
# The least gap where a loop cannot close, relative: Gauss-Newton creeps towards a minimum that is not zero.
LEAST_GAP = 0.05

# Actuator moments, relative: rounding of one expression against another. Measured 2e-14.
MOMENT = 1e-10
# MuJoCo's soft constraint extrapolated on random mechanisms, whose masses differ ten thousandfold, from softnesses a hundred
# thousandth and a millionth of its hardest: what is left is of second order. Measured on 200: 8e-7.
RANDOM_LIMIT = 5e-6

# Gap [m] of an assembled loop: what assembly promises.
GAP_M = 1e-11
# Gap [m] along a sweep: its own promise is 1e-11.
SWEPT_GAP_M = 1e-10
# Coordinates [rad] of one pose, assembled in two ways: both loops' gaps over links of a decimetre.
POSE = 1e-9
# Coordinates and inertias tied by a coupling, against its polynomial: the coupling's gap.
COUPLED = 1e-10
# Weight [N.m, and what is left at its zero] and inertia of a welded four-bar against the one in one piece, relative.
WELD = 1e-9
WELD_NM = 1e-12
# Ends of a reach [rad] of one mechanism, described in two ways.
REACH_END = 1e-8
# A singular pose at which two branches meet [rad]: Newton converges as on a double root, to half of the digits.
BRANCHING = 1e-6
# Order of the determinant's root next to a singular pose, 1/2, at a hundredth to a ten thousandth of a degree.
ROOT_ORDER = 1e-3
# Unit vectors and quaternions against one another: rounding of their components.
UNIT_VECTOR = 1e-14
# Orientation coordinates at home, where they are zero by construction.
CENTRED = 1e-15
# Rates of orientation coordinates against the spin that they stand for, relative: the chart's condition.
SPIN = 1e-13
# Angular momentum [kg m2/s] and energy (relative) of a free top after 1.5 s, integrated to 1e-12.
CONSERVED = 1e-9
# A motion from the efforts that it needs, relative: efforts and accelerations through the condition of J_z and M.
MOTION_FROM_EFFORT = 1e-8
# Acceleration under an effort through a transmission, relative: as TREE_ACCELERATION, through the transmission's moment.
ACTION = 1e-9
# What a motor cannot give of a motion of one freedom [N.m]: nothing but rounding.
MISSED_NM = 1e-9
# Figures as documents print them: to their last digit.
PRINTED_DEG = 0.01
PRINTED_M = 1e-6
PRINTED_N = 1.0
# The five-bar's largest holding torque [N.m] on a grid of poses.
HELD_NM = 0.01
# Generalised forces [N.m] at a rest that was found by Newton on springs of 1e2 N.m/rad.
REST_EFFORT = 1e-6
# Andrews' published start [rad]: tabulated to sixteen digits.
START_POSE = 1e-14


def relative_error(actual: object, expected: object) -> float:
    """Return the largest deviation relative to the largest expected entry; shapes must agree, NaN stays NaN."""
    actual, expected = np.asarray(actual, dtype=float), np.asarray(expected, dtype=float)
    assert actual.shape == expected.shape, f"shape {actual.shape}, expected {expected.shape}"
    return float(np.abs(actual - expected).max() / np.abs(expected).max())


def worst_relative_error(actual: np.ndarray, expected: np.ndarray) -> float:
    """Return the worst `relative_error` over samples (axis 0), each against its own largest entry."""
    assert actual.shape == expected.shape, f"shape {actual.shape}, expected {expected.shape}"
    axes = tuple(range(1, actual.ndim))
    return float(np.max(np.abs(actual - expected).max(axis=axes) / np.abs(expected).max(axis=axes)))
