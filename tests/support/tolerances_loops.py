"""The tolerances of the tests of feedback loops and of the studies, one per quantity: what each protects, what was measured.

Measured with MuJoCo 4.0.0 on x86-64. In decibels, degrees and relative parts, as the reports have them.
"""

# Measured against sampled prediction, up to a tenth of the sampling rate. Measured 2e-3 dB, 0.01 deg.
MEASURED_DB, MEASURED_DEG = 0.02, 0.2
