"""Known troubles of two-arm systems, and minidual's answer to each."""
