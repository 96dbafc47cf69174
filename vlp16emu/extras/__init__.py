"""Tools around the emulator; the core runs without them."""
