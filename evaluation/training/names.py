"""Names of data sets' splits and of what can be trained; loads no JAX, so that help is fast."""

from __future__ import annotations

from agents.registry import FORECASTERS, HYBRID, REACTIVE_EGOS

SPLITS = ("train", "validation", "test")
"""Of data sets of episodes; each has its own seeds."""
GAMMA = "gamma"
"""The network that infers discount factors; it predicts nothing by itself."""
CLONED, PPO = REACTIVE_EGOS
"""The egos that imitate the oracle's actions, and that learn by reinforcement."""
SUPERVISED = (*FORECASTERS, GAMMA, CLONED)
"""Names of the learned models."""
TRAINABLE = (HYBRID, *SUPERVISED, PPO)
