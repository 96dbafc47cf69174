"""How exact a run is, and what it costs."""
