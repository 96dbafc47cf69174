"""What a run needs and leaves out, what it will take, and whether a stream of it keeps up."""
