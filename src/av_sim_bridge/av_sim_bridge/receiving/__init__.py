"""Reception of samples, images and states with ROS time stamps: sockets, threads and stream decoders, without ROS."""
