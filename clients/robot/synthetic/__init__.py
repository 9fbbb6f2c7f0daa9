"""Synthetic corridor with walking people and depth noise, rendered offline."""
