"""Tasks as environments for learning: one world with pictures, or many without."""
