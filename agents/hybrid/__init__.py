"""`hybrid-game`: a network proposes joint futures, a differentiable game makes them equilibria."""
