"""Connection to PX4: the pointing command moves its gimbal and body, its pose is the rig's odometry."""
