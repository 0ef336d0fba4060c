"""Programs for `ros2 run av_sim_bridge`."""
