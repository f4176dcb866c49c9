"""Names of the transcriptions, in a module that is quick to import."""

MAX_DEGREE = 9
# The nodes of the first-order families, on the unit interval.
LOBATTO = {"trapezoid": (0.0, 1.0), "hermite-simpson": (0.0, 0.5, 1.0)}
NAMES = (
    *(f"{name}{form}" for name in LOBATTO for form in ("", "-consistent")),
    *(f"{family}-{degree}" for family in ("radau", "gauss") for degree in range(1, MAX_DEGREE + 1)),
)
# The highest degree of an effort's polynomial on an interval.
EFFORTS = {"constant": 0, "linear": 1, "polynomial": MAX_DEGREE}
# Larger meshes take minutes and are probably typing errors.
MAX_INTERVALS = 20_000
