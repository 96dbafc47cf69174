"""Configurations of SLAM programs for bags of a VLP-16, and a check of bags for a program."""
