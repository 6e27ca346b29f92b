"""Training data and training of learned agents."""
