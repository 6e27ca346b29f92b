"""Stage-wise linear systems."""
