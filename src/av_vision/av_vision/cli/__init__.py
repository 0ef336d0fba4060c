"""Programs: `ros2 run av_vision VERB`."""
