"""Closed-loop episodes: settings, places and endings."""
