"""From UDP ports to dated samples, images and states: sockets, threads and stream decoders; no ROS in here."""
