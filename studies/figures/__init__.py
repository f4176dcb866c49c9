"""Figures: functions that draw into an Axes, and the ones that put them on a page."""
