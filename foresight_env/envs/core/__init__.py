"""Parts that every environment shares: episodes, worlds, scenes and checks."""
