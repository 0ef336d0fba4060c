"""Attacks on the running rig: hostile messages, datagrams, clocks, requests and signals, and what the rig did meanwhile."""
