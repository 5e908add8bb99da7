"""Two Franka controllers: wire format, limits, emulator and client."""
