"""`linkplan tune`: gains from requirements.

In: a bandwidth and margins at the worst pose. Out: PD gains or LQR weights, or the reason why there are none.
"""
