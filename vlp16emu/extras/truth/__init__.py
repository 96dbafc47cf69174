"""Ground truth beside a run."""
