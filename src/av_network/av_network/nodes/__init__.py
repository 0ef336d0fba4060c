"""Thin ROS 2 shells around the algorithms of this package."""
