"""Reinforcement learning: PPO over a batched environment, and the small networks that it leaves."""
