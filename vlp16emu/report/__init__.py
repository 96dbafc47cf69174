"""What can be said about a run beforehand, and about a run or a capture afterwards."""
