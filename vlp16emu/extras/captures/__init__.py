"""Captures of other programs: pcapng, archives, link types other than Ethernet, tags, tunnels and fragments."""
