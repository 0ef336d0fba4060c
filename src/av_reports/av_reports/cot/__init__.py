"""Cursor on Target: events for TAK, and their way there."""
