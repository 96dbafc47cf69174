"""Captures of other programs.

They are pcapng, archives, link types other than Ethernet, tags, tunnels and fragments.
"""
