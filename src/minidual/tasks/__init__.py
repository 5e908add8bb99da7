"""Tasks: where a trial starts and ends, the success test, and the drivers that solve it by hand-written means."""
