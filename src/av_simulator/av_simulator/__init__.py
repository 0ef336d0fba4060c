"""Physics simulator: sound, images and truth of drones, sent as RFlySim sends them."""
