"""What sight teaches hearing: array self-calibration and the offset of clocks."""
