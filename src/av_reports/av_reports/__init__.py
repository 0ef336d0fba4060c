"""Tracks for those who act on them: SAPIENT, Cursor on Target, GeoJSON and CSV."""
