"""Programs for `ros2 run`."""
