"""What a camera sees: scenes, weather, and the renderers that make pictures, depth and truth of them."""
