"""Figures of the simulated sound against formulas and against other simulators."""
