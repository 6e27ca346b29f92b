"""Interior-point method: Newton steps, starts, restarts and implicit derivatives."""
