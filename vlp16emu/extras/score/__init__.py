"""Scores of a pipeline under test against the truth of a run, from files of any tool."""

from vlp16emu.extras.score.card import ScoreCard, ScoreInputs, make_card

__all__ = ["ScoreCard", "ScoreInputs", "make_card"]
