"""A city: cells of space, each with a tracker of its own, that hand tracks over at their borders."""
