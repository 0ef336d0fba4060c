"""The published confidence-gated switch."""
