"""Attacks on the running rig: hostile messages, clocks and signals, and what the rig did meanwhile."""
