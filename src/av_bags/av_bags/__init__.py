"""Recording, reading and replaying bags: mcap and sqlite3 files of ROS 2, without middleware."""
