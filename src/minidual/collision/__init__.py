"""Planning scenes, shapes and collision engines."""
