"""Point clouds as files."""
