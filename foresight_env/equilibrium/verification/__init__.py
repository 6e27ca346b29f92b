"""Tests of an equilibrium: unilateral deviations and best responses."""
