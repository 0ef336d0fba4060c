"""What the nodes of the rig share: lifecycle, diagnostics, parameters, angles and frames."""
