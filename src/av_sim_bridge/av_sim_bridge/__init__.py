"""Bridge from simulators on UDP to the topics of the rig: wire formats, receivers, and one node."""
