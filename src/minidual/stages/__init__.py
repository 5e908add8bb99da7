"""One module per command, turning domain numbers into checks."""
