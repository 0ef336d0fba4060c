"""Physics simulator and bridge from simulators on UDP to the topics of the rig."""
