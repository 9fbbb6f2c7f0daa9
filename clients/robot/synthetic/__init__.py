"""A synthetic corridor with walking people and a depth camera's noise; rendered beforehand, never live."""
