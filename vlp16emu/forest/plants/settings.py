"""What a scene says of plants."""

from typing import Literal

Season = Literal["leaf_on", "leaf_off"]  # with leaves, or as in winter: broadleaves bare, needles on
