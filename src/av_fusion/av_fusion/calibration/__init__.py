"""Calibration of the microphones, and of a further camera, by the first camera."""
