"""From messages to measurements in the body frame."""
