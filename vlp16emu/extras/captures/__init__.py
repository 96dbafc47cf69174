"""Captures of other programs: pcapng, archives, link types beside Ethernet, tags, tunnels and fragments."""
