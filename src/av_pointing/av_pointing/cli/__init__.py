"""Programs for `ros2 run av_pointing`."""
