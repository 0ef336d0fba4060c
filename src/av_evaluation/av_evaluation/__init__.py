"""Evaluation of the rig: replay, offline runs, metrics, experiments, report and monitor."""
