"""Programs for `ros2 run av_px4 NAME`."""
