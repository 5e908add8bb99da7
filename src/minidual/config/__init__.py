"""Configuration models, profiles and their loader; no robotics."""
