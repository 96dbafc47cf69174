"""Configurations of SLAM programs for bags of a VLP-16, and a check of a bag against the needs of a program."""
