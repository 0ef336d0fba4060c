"""The verb `ros2 launch`, with the spelling of the one that an installed ROS 2 brings."""
