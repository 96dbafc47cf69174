"""Accuracy of a run, and its cost."""
