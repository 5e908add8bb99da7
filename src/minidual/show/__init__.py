"""Report, live view, figures and films."""
