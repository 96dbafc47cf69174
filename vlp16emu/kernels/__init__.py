"""Compiled kernels for a fixed processor: kept on disk by content, compiled in parallel before a run."""
