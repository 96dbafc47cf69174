"""Scores of a pipeline under test against the truth of a run, from files of any tool."""
