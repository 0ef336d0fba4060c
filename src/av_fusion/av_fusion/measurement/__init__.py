"""Measurements in the body frame, made of messages."""
