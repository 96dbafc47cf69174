"""Beams, firing times, rotor and clock of a VLP-16 and of similar sensors."""
