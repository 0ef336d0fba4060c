"""Output of simulations to files: sound, video, true states, bags."""
