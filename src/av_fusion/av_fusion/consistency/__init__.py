"""Does the description of the rig hold? Sound, sight and the rig's own motion contradict each other where it does not."""
