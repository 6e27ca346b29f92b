"""Ego policies and what they share: perception and planning."""
