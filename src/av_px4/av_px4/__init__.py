"""Interface to PX4: pointing commands to its gimbal and body, and its pose as the rig's odometry."""
