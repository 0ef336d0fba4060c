"""Several targets at once: each is a Bernoulli component whose density is that of a single target."""
