"""Sources of images: files, V4L2 devices, RealSense cameras."""
