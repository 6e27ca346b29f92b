"""Execution of trials: workers, storage, provenance."""
