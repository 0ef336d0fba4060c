"""Motion of the simulated rig: its body in wind, its yaw, its pursuit of a target, and its gimbal."""
