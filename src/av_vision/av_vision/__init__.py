"""Camera to detections to bearings."""
