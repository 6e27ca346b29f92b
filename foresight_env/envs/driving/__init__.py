"""Cars on highway-env's roads."""
