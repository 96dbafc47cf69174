"""Compiled kernels: for a fixed processor, kept on disk by content, and compiled in parallel before a run."""
