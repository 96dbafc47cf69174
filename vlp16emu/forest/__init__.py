"""Generated forests and plots of measured trees: one kind of world."""
