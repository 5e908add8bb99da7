"""Planning scenes, shapes and the two collision engines."""
