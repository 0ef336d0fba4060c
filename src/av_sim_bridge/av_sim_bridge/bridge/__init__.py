"""Sockets, threads and intake of the simulator's streams; no ROS in here."""
