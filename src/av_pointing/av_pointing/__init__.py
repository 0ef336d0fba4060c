"""From a track to a pointing command that is safe to obey."""
