"""Tracking laws: from a control instant and the measured state to efforts.

In: a sampled reference and the reduced model. Out: pure laws that implement `Tracker` or `TrackerWithMemory`.
"""
