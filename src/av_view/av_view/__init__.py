"""The rig in a browser and in other viewers, and a check of the machine."""
