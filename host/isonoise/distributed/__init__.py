"""Rendering on several devices, and on a cluster: a wave is cut into tasks, pure functions that any worker computes."""
