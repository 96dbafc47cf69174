"""A forest that grows itself, or that somebody has measured: one world among others."""
