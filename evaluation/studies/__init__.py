"""Studies: configured sets of trials and their rows."""
