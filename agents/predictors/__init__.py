"""Classical and game-theoretic predictors."""
