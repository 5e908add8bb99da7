"""Tasks, trials and the judge of success."""
