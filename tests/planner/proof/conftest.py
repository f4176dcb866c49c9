"""Balls have the precision in these tests that a test's module asks for as `BITS`, and their own again after each test."""

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
