"""Generated sample recordings."""
