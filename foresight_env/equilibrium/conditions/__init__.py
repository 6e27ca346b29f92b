"""First-order conditions: residual, linearisation and curvature."""
