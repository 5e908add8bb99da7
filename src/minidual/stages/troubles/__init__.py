"""Known troubles of two-arm systems, and what minidual does about each."""
