"""What all packages share: base of nodes, clocks, parameters, frames, geometry of sensors, configuration files."""
