"""The MuJoCo world: model, contacts, cameras."""
