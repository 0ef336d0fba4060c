"""Calibration of the microphones by the camera."""
