"""Shared by all packages: base of nodes, clocks, parameters, frames, geometry of sensors, configuration files."""
