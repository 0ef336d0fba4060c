"""Benchmarks of the localizer against independent ground truth."""
