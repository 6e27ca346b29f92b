"""Scenarios: one module each, composing games with geometry and initial distributions."""
