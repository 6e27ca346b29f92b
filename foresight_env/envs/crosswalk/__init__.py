"""The crosswalk: PettingZoo, Gymnasium, functional and vector environments."""
