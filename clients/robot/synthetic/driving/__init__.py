"""Synthetic scenes in which the robot drives."""
