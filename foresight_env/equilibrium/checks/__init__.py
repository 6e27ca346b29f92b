"""Validation of input and diagnosis of failures."""
