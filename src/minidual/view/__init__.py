"""Live views of a running world."""
