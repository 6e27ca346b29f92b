"""The intersection with pedestrians and cars."""
