"""Leaders: one module for each device or program that demonstrates."""
