"""Each test computes with the precision of balls that its module sets as `BITS`; the default returns after the test."""

import mpmath as mp
import pytest
from flint import ctx

from tests.support.mp_functions import DIGITS


@pytest.fixture(autouse=True)
def precision(request):
    before = ctx.prec, ctx.cap
    ctx.prec = getattr(request.module, "BITS", ctx.prec)
    with mp.workdps(DIGITS):
        yield
    ctx.prec, ctx.cap = before
