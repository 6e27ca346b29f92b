"""Protocols of predictors and ego policies."""
