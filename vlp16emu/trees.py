"""Tables of TOML and JSON files, as they are parsed and written.

Their values have the types of these formats.
"""

from collections.abc import Mapping
from typing import Any

Tree = dict[str, Any]
Table = Mapping[str, Any]  # one that is not changed
