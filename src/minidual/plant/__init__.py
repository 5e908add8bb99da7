"""The MuJoCo world."""
