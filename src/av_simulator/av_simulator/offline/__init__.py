"""Simulations as files: sound, video, truth, bags and previews."""
