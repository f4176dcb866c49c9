"""The tolerances of the tests of feedback loops and of the studies, one per quantity: what each protects, what was measured.

Measured with MuJoCo 4.0.0 on x86-64. In decibels, degrees and relative parts, as the reports have them.
"""

# Measured against sampled prediction, up to a tenth of the sampling rate. Measured 2e-3 dB, 0.01 deg.
MEASURED_DB, MEASURED_DEG = 0.02, 0.2
# Measured closed loops against the prediction where the coherence is above 0.99. The loop constraint of the model gives way
# by a thousandth of its load, which the rigid prediction leaves out. Measured 0.018 dB and 0.11 deg, near Nyquist.
KNEE_DB, KNEE_DEG = 0.1, 1.0
# Predicted multipliers against the measured decay. Measured 8e-4 with feedforward, 1.4e-2 where soft PD goes its own way.
DECAY = 0.05
# Gains for twice the bandwidth, 4 and 2 times: gains lie on a grid that is refined about the best.
GAINS_SCALED = 0.05
# Disk margins against python-control's on a grid of frequencies, relative.
DISK = 1e-3
# Crossovers, peaks and efforts against those of a grid, relative: a parabola's height between samples.
ON_A_GRID = 1e-4
# A crossover, relative: its bracket.
CROSSOVER = 1e-5
# Phase [deg] and gain [dB] margins, against python-control's and at the crossover itself.
MARGIN = 1e-3
# The gain margin at Nyquist's frequency [dB]: one evaluation against another.
AT_NYQUIST_DB = 1e-6
# Poses over a reach, references as they are drawn [deg].
POSE_DEG = 1e-6
# The longest period, relative: steps of its search.
LONGEST_PERIOD = 0.01
# The last sample of a run [s].
LAST_SAMPLE_S = 1e-3
# A delay's own phase where the hold is short, relative.
SHORT_HOLD = 1e-2
# One step of the prediction against MuJoCo's, relative: its linearisation about the operating point.
STEPPED = 1e-6
# A frequency as a whole number of periods in whole samples, relative; the nearest of them to one that was asked.
WHOLE_PERIODS = 0.01
NEAREST_WHOLE = 5e-3
# Loops of the five-bar, measured with the other loop closed: soft loops, as the knee's.
COUPLED_DB, COUPLED_DEG = 0.1, 1.0
# Response below saturation against the linear one, relative: soft loops at 25 and 40 Hz.
UNSATURATED = 1e-3
# A saturation's describing function against its closed form, relative: quadrature.
SATURATION = 1e-9
# The same of unequal limits against python-control's of four thousand samples, relative.
NUMERICAL_SATURATION = 1e-3
# The command of a small signal against the linear one, relative.
SMALL_COMMAND = 1e-6
# The critical damping gain, relative: its bisection.
CRITICAL_KD = 1e-5
# A delay margin found by whole substeps against the continuous one, relative.
DELAY_MARGIN = 0.02
# The largest radius of a map against its loops' own, relative.
RADIUS = 1e-9
# Quick margins against the margins: a coarser grid of frequencies.
QUICK, QUICK_DEG = 5e-3, 0.3
# Liouville's determinant, relative: slopes by differences of samples.
LIOUVILLE = 0.02
# Speeds [rad/s] at which a simulated model counts as settled.
SETTLED_SPEED = 1e-4
# A batch of simulations against single runs [rad]: the same operations in the same order. Measured 0; times 1e3 for efforts.
SAME_RUN = 1e-13
