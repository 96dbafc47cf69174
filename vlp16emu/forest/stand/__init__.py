"""Which plants and things are where, how they are labelled, and how trees sway in the wind."""
