"""Compiled kernels: for which processor, kept on disk by content, and compiled side by side before a run."""
