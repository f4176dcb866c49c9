"""Tracking laws: from a control instant and the measured state to efforts.

In: a `Reference` and the reduced model. Out: PD, feedforward and LQR as pure laws behind the protocol `Tracker`.
"""
