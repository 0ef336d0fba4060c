"""Attacks on the running rig: hostile messages, datagrams, clocks and signals, and what the rig did meanwhile."""
