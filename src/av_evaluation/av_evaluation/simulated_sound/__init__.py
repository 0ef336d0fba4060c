"""Comparison of the simulated sound with formulas and with other simulators."""
