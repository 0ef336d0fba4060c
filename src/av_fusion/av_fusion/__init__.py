"""Fusion of directions of arrival and detections to the bearing of one target; launch files of the suite."""
