"""What others build around the emulator; the core runs without it."""
