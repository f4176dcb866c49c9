"""The tolerances of the planner's and the controllers' tests, one per quantity: what each protects, and what was measured.

Measured with MuJoCo 4.0.0 and CasADi 3.8.2 on x86-64. A tolerance stands a few times above what was measured, for other
compilers' rounding, and well below what a wrong term, sign or factor would show.
"""

# Constants on the unit interval: nine Radau nodes lose five digits of sixteen to the inverse of their Bernstein matrix.
UNIT = 1e-10
# Polynomials of random coefficients through those constants: the same loss times values up to a thousand.
UNIT_VALUES = 1e-7
# Two evaluations of one formula, relative: rounding of a few operations.
ROUNDING = 1e-12
# A figure and its closed form, relative (absolute where it is an angle): rounding through a loop closed to 1e-11 m.
SAME_FIGURE = 1e-9
# What counts as still [rad/s] or unchanged: anything that is moved at all in these tests moves by 1e-3 and more.
STILL = 1e-9
# A speed that a stable loop has forgotten, having begun at 1e-2 [rad/s].
DIED_OUT = 1e-6
# Hand-assembled derivatives against CasADi's own, relative to the largest entry: two orders of summation. Measured 3e-16.
DERIVATIVE = 1e-12
# The same against central differences with a step of 1e-5: truncation 1e-10 times third derivatives of order one.
DIFFERENCE = 1e-6
# Rows of a program at its own solution, scaled: the solver's 1e-10 and the rounding of leaving and entering a motion.
ROWS = 1e-7
# Slope of log error over log mesh width: the next order's share of the error on the finest of the meshes. Measured 0.06.
ORDER = 0.15
# Minimum time, relative. The solver's complementarity leaves 1e-9; a switch smeared over one interval leaves 1e-5 to 1e-4.
MINIMUM_TIME = 1e-7
# Least effort, relative, where the optimum is a polynomial that the scheme holds exactly. Measured 5e-16.
EXACT_EFFORT = 1e-9
# A limit that binds though the objective hardly feels it: the share by which the barrier keeps below it (2.2e-6 measured).
TOUCHED = 1e-5
# Least effort of the knee against Pontryagin's conditions, relative: fortieth-mesh radau-3 and solve_bvp. Measured 2e-11.
LEAST_EFFORT = 1e-8
# Figures of the reference table and its own recomputation here: tabulated to sixteen digits. Measured 1e-12.
REFERENCE = 1e-9
# Effort beyond a limit [N.m]: none at all, coefficients are cut at the limit.
EFFORT_EXCESS = 0.0
# An excess that was put in on purpose, relative: found on a grid that ends a 1e-12 share before each break.
EXCESS = 1e-6
# An effort that is at its limit, relative: the solver's complementarity leaves 1e-8.
AT_LIMIT = 1e-5
# Efforts [N.m] on both sides of where none may jump, or against a straight line: the solver's 1e-10, scaled back.
EFFORT_JUMP = 1e-6
# The least limit with which a duration would do, relative: cuts at its switches make it exact, a smeared switch leaves 1e-4.
NEEDED_EFFORT = 1e-5
# The largest effort of a coarse grid against a fine one, relative: a parabola's height between samples.
PEAK_ON_A_GRID = 1e-3
# A loop's gap in a plan [m]: what DESIGN promises. Measured 2e-16.
CLOSURE_M = 1e-9
# Independent joints after integrating a plan, against the plan [deg]: what DESIGN promises of every plan.
INTEGRATION_DEG = 0.01
# The same by scipy with the oracle's own dynamics, on smooth plans or with restarts at the breaks [deg]. Measured 6e-4.
SECOND_ROUTE_DEG = 0.01
# Boundary states of a plan [rad, rad/s over the mean speed]: bounds are met exactly, the rest is scaling. Measured 1e-14.
BOUNDARY = 1e-9
# A boundary speed [deg/s], in the units of files.
SPEED_DEG_S = 1e-6
# Position and velocity at both sides of a break, velocity and the derivative of position; relative to the largest.
CONTINUITY = 1e-7
# A range that binds is reached to this [deg]: the motion turns on it between two nodes.
BINDS_DEG = 0.1
# A reference that limits allow, under the smoothing term [deg rms]. Measured 2e-4.
FOLLOWED_DEG = 1e-3
# A prescribed sinusoid, interpolated by degree eight [rad]. Measured 1e-14.
SINUSOID = 1e-10
# Share of home's distance to a singular pose, against the transmission angle's sine, to which it is near but not equal.
SINGULARITY = 0.3
# The certificate's slack on ranges and speeds [rad, rad/s]: rounding of degrees.
RANGE_SLACK = 1e-9
# Energy balance of a plan, relative to the work done: trapezia across a switch and the collocation's own error.
ENERGY = 1e-3
# A motion where two descriptions of the same program must agree, relative: both are solved to 1e-10.
SAME_MOTION = 1e-7
# The instant and size of the sinusoid's peak effort: refined to 1e-12 s, printed to four digits.
PEAK = 1e-9
# What CSV keeps, relative: twelve digits.
CSV = 1e-10
# Matrix exponential of a double integrator, relative: rounding.
EXPONENTIAL = 1e-13
# Riccati gains against scipy's own solution, relative: condition of the Riccati equation. Measured 1e-11.
GAINS = 1e-8
# A loop's gap while MuJoCo tracks [m]: the constraint is soft by design; micrometres are what the model file promises.
ROLLOUT_GAP_M = 1e-5
# The knee's sinusoid under PD 200/1 [deg rms]: measured 0.0236; twice the gains' lag would show 0.05.
SINE_RMS_DEG = 0.03
# Feedforward and LQR against PD alone, ratio of rms errors. Measured 0.0012 to 0.006.
FEEDFORWARD_GAIN = 0.1
# A planned effort alone, without feedback, in MuJoCo [deg from the goal]: first-order integration at 1e-5 s, soft loop.
OPEN_LOOP_DEG = 0.1

# An extreme between a certificate's samples by the parabola through three of them: a third-order remainder, measured 2e-6.
EXTREME = 1e-5

# Optimal control of a user's differential equation. An optimum against its closed form, relative: the solver's 1e-10, and
# radau polynomials on smooth motions with cuts at switches. Measured 3e-12.
ODE_CLOSED_FORM = 1e-9
# The same published to six digits from a finite mesh, relative. Measured 2e-6.
ODE_FOUR_DIGITS = 3e-6
# States and efforts against a closed form, absolute, of order one: what a radau-3 polynomial leaves between nodes.
# Measured 4e-7.
ODE_STATE = 1e-6
# Least positive work where a speed changes its sign inside an interval, relative: quadrature of a kink. Measured 5e-6.
WORK_WITH_TURNS = 2e-5
# Positive work with efforts constant over intervals and cuts where they jump, relative. Measured 7e-8.
LEAST_WORK = 1e-6
SMOOTHED = 1e-3
WORK_INTEGRAL = 2e-3
# A term of the objective against Gauss's rule along the motion, relative: both exact for the effort's polynomials.
TERM_INTEGRAL = 1e-9
# MuJoCo's pin at impedance 0.9999, relative: 1e-4 in the constraint's acceleration, squared forces.
SOFT_PIN = 2e-3
# Limits of power, rate, line, pin force and singular margin between nodes, relative: drawn in where they were overrun, and
# the certificate's slack of 1e-9.
FURTHER_LIMIT = 1e-8
# A limit that binds is reached, relative: drawn in by a tenth more than it was overrun between nodes.
BINDS = 1e-3
# Least time along arcs that are held at a path limit, relative: what limits are drawn in by. Measured 6e-7.
LEAST_TIME_ON_ARCS = 2e-6
# Least time where arcs on a limit meet arcs at the effort's, relative: exact where they are held (4e-11 on power), and what
# the convex hull of a motor's line keeps off it. Measured 6e-7.
TIME_WITH_ARCS = 2e-6
# Least effort by a waypoint at a free instant against scipy's minimum over instant and speed, relative: scipy's own 1e-9.
WAYPOINT_EFFORT = 1e-7
# Least effort, work and time against closed forms whose effort bends at a limit, relative. Measured 1e-12 to 6e-8; a bend
# inside an interval leaves 1e-6 to 1e-3.
SATURATED = 2e-7

# A servo's motion against a motor's under the same efforts [rad, m]: the servo's ctrl is inverted to rounding.
SERVO_AS_MOTOR = 1e-11
# Geoms' distance [m] at the instant at which they first meet, over the mechanism's size: the instant's bracket.
TOUCHING = 2e-6
# The same as SATURATED where the bend falls at the motion's end.
SATURATED_ROUGHLY = 1e-6
# Power along an arc at its limit, relative, at the nodes: what the solver leaves of its rows.
ON_THE_ARC = 1e-6
# A least time with its switches found and its mesh refined, relative; the state's error at its end [deg].
REFINED_TIME = 1e-8
REFINED_DEG = 1e-6
# A longest duration that is used to the full, relative, and the effort that falls with its third power.
LONGEST_DURATION = 1e-6
# A best duration, relative: the objective is flat there, met to its square.
BEST_DURATION = 1e-5
# A least time against the phase plane's, relative: both sides' own errors are below 1e-7.
PHASE_PLANE_TIME = 1e-6
# An objective on a mesh of six intervals before it is refined, relative.
COARSE_MESH = 1e-2
# Objectives after refining to 1e-7 deg, and of the best of several starts on twenty intervals, relative.
REFINED_EFFORT = 1e-7
BEST_START = 1e-6
# The knee's peak effort as documents print it [N.m].
PRINTED_NM = 0.1
# The highest frequency that limits allow, relative: its bisection's width.
HIGHEST_FREQUENCY = 1e-4
# The angle at a waypoint's best instant [deg]: scipy's instant, to the root of its own tolerance.
WAYPOINT_DEG = 1e-2
# A plan through compiled and through interpreted functions, relative: the order of sums differs.
COMPILED = 1e-10
# Solving again against a fresh plan where limits were tightened after certifying: the amount differs, relative.
TIGHTENED_ANEW = 1e-4
# As SECOND_ROUTE_DEG, of a slide [m].
SECOND_ROUTE_M = 1e-5
# Work against energy by trapezia over a plan, relative: across switches, and the collocation's own error.
WORK = 1e-3
# LQR's largest error in MuJoCo [deg, m], and in turns that take a few hundredths of a second.
LQR_DEG = 0.01
LQR_M = 1e-4
LQR_IN_A_FAST_TURN_DEG = 0.1
# The peer's closed form, typed by hand, against the reduced model, relative: rounding through a closed loop.
TYPED_BY_HAND = 1e-11
# Places of sites against MuJoCo's and against kinematics by hand [m], of arms and linkages of half a metre: rounding.
SITE_M = 1e-12
# Angles by inverse kinematics against the cosine rule [rad]: places within 1e-9 of the extent, away from singular poses.
IK_RAD = 1e-8
# How far out of reach a place is against the closed form [m]: a least distance is flat where it is least.
OUT_OF_REACH_M = 1e-7
# How near to an active limit on a site a motion comes [m]: rows stand off it by IPOPT's relaxation and by what a certificate
# takes off, measured 6e-8, and by an interval's bend where it only touches it, measured 2e-5.
SITE_BINDS_M = 5e-5
# What the solver's own end leaves of a re-solve that a Newton step is held against [rad; N.m]: its last barrier, 1e-9 of the
# scaled unknowns, measured 2e-8 and 1e-6 where limits bind weakly, 4e-4.
SOLVERS_OWN_POSITION, SOLVERS_OWN_EFFORT = 1e-7, 2e-3
# The least objective within a limit as an expression, kept at nodes and tightened, against the built-in one: measured 7e-8.
EXTRA_LIMIT = 1e-6
# Two searches for one motion along a limit at nodes, each tightened by what it overran between them: measured 1.2e-4.
TIGHTENED_TWICE = 5e-4
