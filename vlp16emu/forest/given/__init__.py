"""Measured trees, and models of trees, that the user brings."""
