"""Tests grow their worlds themselves, unless they are about what is kept."""

import os

os.environ["VLP16EMU_CACHE_DIR"] = "off"
