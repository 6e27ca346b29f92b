"""Prediction windows from recordings and simulations."""
