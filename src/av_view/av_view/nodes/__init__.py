"""Thin ROS 2 shells around the rest of this package."""
