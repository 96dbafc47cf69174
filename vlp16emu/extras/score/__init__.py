"""Scores of a pipeline under test against the ground truth of a run, from files of any tool."""
