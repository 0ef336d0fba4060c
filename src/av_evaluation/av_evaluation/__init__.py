"""How well a run tracked its target: a log of what happened, figures from it, and pictures."""
