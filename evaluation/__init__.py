"""Studies: rollouts, metrics, statistics, results on disk, figures, command line."""
