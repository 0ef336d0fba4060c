"""Calibration of the microphones by the camera: array self-calibration and the offset between both clocks."""
