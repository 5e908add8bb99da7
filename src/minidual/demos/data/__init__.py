"""Demonstrations of any origin: HDF5 episodes of this program or of ALOHA, and LeRobot datasets."""
