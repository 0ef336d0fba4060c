"""Conversion of messages to measurements in the body frame."""
