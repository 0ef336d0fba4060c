"""Microphones to direction of arrival."""
