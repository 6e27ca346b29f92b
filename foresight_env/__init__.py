"""Games between agents that differ in foresight: environments, equilibria and inference."""

__version__ = "0.1.0"
