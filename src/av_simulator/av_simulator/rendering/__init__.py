"""Rendering: scenes, weather, and renderers of images, depth and true bounding boxes."""
