"""What a camera sees: scenes, weather, and the renderers that make images, depth and truth of them."""
