"""The verb `ros2 launch`, with the arguments of the verb in an installed ROS 2."""
