"""One file a command: calls the domain and turns its numbers into checks."""
