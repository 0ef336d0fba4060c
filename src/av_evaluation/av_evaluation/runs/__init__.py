"""Cases, runs and their schedule."""
