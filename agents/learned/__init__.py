"""Learned predictors: networks, their training, and their weights. Loads equinox."""
