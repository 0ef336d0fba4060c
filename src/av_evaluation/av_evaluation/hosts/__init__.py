"""Rigs as hosts of their own in a network that delays, loses and parts, over DDS."""
