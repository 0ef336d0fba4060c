"""PX4 and the rig: its gimbal and body are pointed, its attitude is the rig's odometry."""
