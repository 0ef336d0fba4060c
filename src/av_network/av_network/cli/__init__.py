"""Programs of several rigs."""
